"""The first thing read: how far off the calibrated robot still is, and what that was measured on."""

import numpy as np

from workbench.report.text import counted, rounded

_NAMES = (("rms_mm", "RMS"), ("mean_mm", "mean"), ("p95_mm", "95 % below"), ("max_mm", "max"))


def section(calibration, errors) -> dict:
    """Title, the four large numbers and the sentences under them."""
    recording, held_out = calibration.recording, calibration.held_out
    return {
        "title": recording.title or recording.name or "Calibration",
        "robot": calibration.robot.name,
        "numbers": [(name, rounded(held_out.get(key))) for key, name in _NAMES],
        "meaning": meaning(calibration, errors.held),
        "gain": gain(calibration),
        "caution": caution(calibration),
        "warning": "" if calibration.solution.converged else f"The solve {calibration.solution.outcome}.",
    }


def meaning(calibration, held: np.ndarray) -> str:
    """What the large numbers say, and on how many poses and folds."""
    poses = len(np.unique(calibration.recording.poses[held]))
    folds = calibration.held_out.get("folds", 0)
    where = f"in {counted(folds, 'fold')}" if folds > 1 else "in one test set"
    return (
        f"This is how far the calibrated model's prediction lies from the measured point, as a 3-D distance, on "
        f"{counted(int(held.sum()), 'sample')} in {counted(poses, 'pose')} that no step of the solve had seen "
        f"({where}; repeats of one pose never stand on both sides)."
    )


def gain(calibration) -> str:
    """Nominal, fit and held-out RMS beside one another."""
    nominal, held_out = calibration.nominal["rms_mm"], calibration.held_out["rms_mm"]
    return (
        f"With the nominal geometry, base and tool alone fitted, it is {rounded(nominal)} mm RMS: "
        f"{rounded(nominal / held_out)} times as much. On the samples of the fit itself it is "
        f"{rounded(calibration.fit['rms_mm'])} mm."
    )


def caution(calibration) -> str:
    """What makes the held-out numbers less than a proof: choice of stages, suspect samples, noise."""
    words = []
    if calibration.held_out.get("folds", 0) > 1 and len(calibration.stages) > 1:
        words.append(
            "Which stages to keep was decided on these same folds; name test samples for a number that "
            "no choice has touched."
        )
    suspects = len(calibration.suspects)
    if suspects:
        words.append(
            f"Far outside the others, perhaps faulty, and yet counted here: {counted(suspects, 'sample')} "
            f"(number {_some(calibration.suspects)})."
        )
    noise = getattr(calibration, "noise", None)
    words.extend(noise.warnings if noise is not None else ())
    return " ".join(words)


def _some(numbers):
    more = f" and {len(numbers) - 12} more" if len(numbers) > 12 else ""
    return ", ".join(map(str, numbers[:12])) + more
