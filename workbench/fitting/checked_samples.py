"""The one way by which a command takes samples of a robot: loaded, without copies, and checked for plausibility.

Every command that fits a robot starts here, so that none accepts a recording that another one refuses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from datasets.recording import Recording
from datasets.trust import accepted_by_option, naming_option
from robot_model.files.loading import load_robot, whole_keys
from robot_model.measurements import check_measures, samples_of
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.core.model import Model
from workbench.fitting.named_rows import NamedRows, without_named_rows
from workbench.fitting.plausibility import check_plausibility
from workbench.fitting.plausibility.robot_files.far_geometry import CAUSE, OTHER_ROBOT
from workbench.fitting.plausibility.suspicion import HARMLESS_TO_THE_FIT, Suspicion
from workbench.fitting.row_order import without_sorted_rows
from workbench.fitting.start_ambiguity import ambiguity_sentence

# intervals between samples by which the instant of an effect may differ from that of a jump
_JUMP_SLACK = 3.0


@dataclass(frozen=True)
class CheckedSamples:
    """A robot and the moving rows of a recording, n samples.

    `suspicions`: sentences on what may be wrong with the recording as a whole, for which a solution is not used
    without --force. `warnings`: these, after what reading the recording, leaving out copies and faulty single
    rows had to say. `far_geometry`: those of the doubts that say that the arm is another one than the robot file
    describes, for the verdict. `jumps`: of those of the doubts that say that something moved between two samples, the
    numbers of these. `left_out`: numbers of the samples that the check names as wrong and that are not to be fitted.
    """

    robot: Robot
    recording: Recording
    suspicions: tuple[str, ...]
    far_geometry: str = ""
    jumps: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    left_out: tuple[int, ...] = ()

    def warnings_about(self, model: Model) -> tuple[str, ...]:
        """The doubts that remain with a model: not those about a jump that one of its effects makes."""
        instants = [e.options["after"] for e in model.effects if e.options.get("after") is not None]
        return tuple(
            suspicion
            for suspicion in self.suspicions
            if suspicion not in self.jumps
            or not self._begins_there(self.jumps[suspicion], instants)
        )

    def _begins_there(self, jump: tuple[int, int], instants: Sequence[float]) -> bool:
        """Whether an effect begins within a few samples of a jump; instants: s, or rows where no time is recorded."""
        rows = [int(np.flatnonzero(self.recording.sample_ids == number)[0]) for number in jump]
        time = self.recording.columns.get("time_s", np.arange(self.recording.n, dtype=float))
        slack = _JUMP_SLACK * float(np.median(np.diff(np.unique(time))))
        low = min(time[rows]) - slack
        high = max(time[rows]) + slack
        return any(low <= instant <= high for instant in instants)

    @property
    def warnings(self) -> tuple[str, ...]:
        return (*self.recording.warnings, *self.suspicions)


def check_samples(
    recording: Recording,
    trust_data: bool = False,
    fit_samples: Sequence[int] | None = None,
    test_samples: Sequence[int] | None = None,
    without_wrong_rows: bool = False,
) -> CheckedSamples:
    """The samples of a recording and its nominal robot, after the plausibility check of the rows to be fitted.

    trust_data: what would be refused is a warning instead. Without it, a direction of gravity and mechanical
    couplings that explain the recording replace those of the robot file, in robot and recording, with a warning.
    fit_samples, test_samples: sample numbers, as of `workbench.jobs.robot.calibrate.calibrate`.
    without_wrong_rows: of the rows to be fitted, those that the check names are listed in `left_out`, and the others
    are checked again; not with trust_data. Raises InputError where the recorded data cannot be right.
    """
    check_measures(recording)
    samples = without_sorted_rows(samples_of(recording))
    robot = load_robot(recording.robot, f"robot of {recording.name}")
    ambiguity = ambiguity_sentence(robot, samples)
    if ambiguity is not None:
        samples = replace(samples, warnings=(*samples.warnings, ambiguity))
    fitted = samples.select(rows_to_fit(samples, fit_samples, test_samples))
    if without_wrong_rows and not trust_data:
        named = without_named_rows(robot, fitted)
    else:
        named = NamedRows(check_plausibility(robot, fitted))
    samples = replace(samples, warnings=(*samples.warnings, *named.sentences))
    suspicions, far_geometries, jumps = [], [], {}
    for suspicion in named.suspicions:
        if suspicion.robot_keys and not trust_data:
            robot, samples = _with_keys(samples, suspicion)
            continue
        if suspicion.certain and not trust_data:
            raise InputError(naming_option(suspicion.sentence))
        if suspicion.cause in (CAUSE, OTHER_ROBOT):
            far_geometries.append(suspicion.sentence)
        if suspicion.cause in HARMLESS_TO_THE_FIT:
            samples = replace(samples, warnings=(*samples.warnings, suspicion.sentence))
            continue
        sentence = (
            accepted_by_option(suspicion.sentence) if suspicion.certain else suspicion.sentence
        )
        suspicions.append(sentence)
        if suspicion.instant is not None:
            jumps[sentence] = suspicion.instant
    far_geometry = " ".join(far_geometries)
    return CheckedSamples(robot, samples, tuple(suspicions), far_geometry, jumps, named.numbers)


def _with_keys(samples: Recording, suspicion: Suspicion) -> tuple[Robot, Recording]:
    """Robot and samples with the keys of the robot file that explain the recording, and a warning that says so.

    Under a wrong direction of gravity, or with drives on wrong joints, other effects would be estimated in their place.
    """
    keys = {**whole_keys(samples.robot), **suspicion.robot_keys}
    warnings = (*samples.warnings, f"{suspicion.sentence} This result uses {suspicion.use}.")
    return load_robot(keys), replace(samples, robot=keys, warnings=warnings)


def rows_to_fit(
    samples: Recording,
    fit_samples: Sequence[int] | None = None,
    test_samples: Sequence[int] | None = None,
) -> np.ndarray:
    """(n,) True for rows that are fitted: those named for it, else all that are not named for testing."""
    if fit_samples is not None:
        return np.isin(samples.sample_ids, fit_samples)
    if test_samples is not None:
        return ~np.isin(samples.sample_ids, test_samples)
    return np.ones(samples.n, bool)
