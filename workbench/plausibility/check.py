"""All plausibility checks of one recording, in order."""

from workbench.plausibility.suspicion import Suspicion


def check_plausibility(robot, recording) -> tuple[Suspicion, ...]:
    """Possible mistakes of a recording, the most serious first; empty where nothing looks wrong.

    robot: the nominal arm. recording: its moving rows, one a sample (`robot_model.measurements.samples_of`).
    """
    from workbench.suspicion import suspicion

    found = suspicion(robot, recording, float("inf"))
    return () if found is None else (Suspicion(found.sentence, found.certain),)
