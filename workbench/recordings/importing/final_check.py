"""The last check of an import: does the recording fit its robot at all, and if not, which mistake explains it?"""

from collections.abc import Sequence

from datasets.trust import accepted_by_option, naming_option
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.fitting.plausibility import check_plausibility
from workbench.recordings.importing.fits import CandidateFit, compare_readings


def check_fit(
    robot: Robot, recording, fits: Sequence[CandidateFit], trust_data: bool
) -> tuple[str, ...]:
    """Sentences on what is unusual. Raises InputError where the recording does not fit its robot.

    fits: of the readings that were compared, empty where nothing had to be decided. trust_data: a misfit is a warning.
    """
    best = fits[0] if fits else None
    if best is None:
        compared = compare_readings(robot, [("as mapped", recording)])
        best = compared[0][1] if compared else None
    if best is not None and best.is_good:
        return ()
    found = check_plausibility(robot, recording)
    sentence = found[0].sentence if found else _sentence(robot, best)
    if best is None and not found:
        return (sentence,)
    if not trust_data:
        raise InputError(naming_option(sentence))
    return (accepted_by_option(sentence),)


def _sentence(robot: Robot, best: CandidateFit | None) -> str:
    if best is None:
        return (
            "The rows are too few to test units and conventions on the robot; compare the mapping with the files "
            "before you use the result."
        )
    return (
        f"The recording does not fit '{robot.name}' under any reading of its columns (best {best.words}); check that "
        "the robot is the right one, that joint and measured rows belong together, and the mapping."
    )
