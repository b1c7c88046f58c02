"""Headline of the page: remaining error of the calibrated robot and the samples that it was measured on."""

import numpy as np

from workbench.report.calibration.errors import FIGURES, POSITION, ROTATION, Errors, Kind, kinds_of
from workbench.report.text import counted, rounded


def section(calibration, errors, rotation=None, verdict: str = "") -> dict:
    """Title, four large numbers for each kind of error, and the sentences below them.

    verdict: the sentences that judge the held-out errors.
    """
    recording = calibration.recording
    held_out = calibration.held_out
    return {
        "title": recording.title or recording.name or "Calibration",
        "robot": calibration.robot.name,
        "kinds": [
            _numbers(held_out, errors_of_kind.kind)
            for errors_of_kind in (errors, rotation)
            if errors_of_kind is not None
        ],
        "meaning": meaning(calibration, errors),
        "gain": gain(calibration),
        "caution": caution(calibration),
        "verdict": verdict,
        "warnings": [f"Warning: {text.rstrip('.')}." for text in calibration.warnings],
        "warning": ""
        if calibration.solution.converged
        else f"The solver {calibration.solution.outcome}.",
    }


def _numbers(held_out: dict, kind: Kind) -> dict:
    values = [(name, rounded(held_out.get(kind.key(figure)))) for figure, name in FIGURES.items()]
    return {"what": kind.quantity, "unit": kind.unit, "numbers": values}


def meaning(calibration, errors: Errors) -> str:
    """Meaning of the large numbers, with the count of poses and folds."""
    is_judged = errors.is_held_out
    poses = len(np.unique(calibration.recording.poses[is_judged]))
    folds = calibration.held_out.get("folds", 0)
    where = f"in {counted(folds, 'fold')}" if folds > 1 else "in one test set"
    orientation = (
        ", and angle between the two orientations"
        if ROTATION.key("rms") in calibration.held_out
        else ""
    )
    if errors.kind == POSITION:
        distance = "Distance between the prediction of the calibrated model and the measured point"
    else:
        distance = f"{errors.kind.quantity.capitalize()} with the calibrated model"
    return (
        f"{distance}{orientation}, on "
        f"{counted(int(is_judged.sum()), 'sample')} in {counted(poses, 'pose')} held out from the fit "
        f"({where}; repeats of a pose are always in the same fold)."
    )


def gain(calibration) -> str:
    """Nominal, fit and held-out RMS in comparison."""
    return " ".join(_gain(calibration, kind) for kind in kinds_of(calibration))


def _gain(calibration, kind: Kind) -> str:
    key = kind.key("rms")
    unit = kind.unit
    nominal = calibration.nominal[key]
    fit = calibration.fit[key]
    held_out = calibration.held_out[key]
    return (
        f"RMS {kind.name} error with the nominal geometry (only base and tool fitted): {rounded(nominal)} {unit}, "
        f"{rounded(nominal / held_out)} times the held-out error. "
        f"RMS error on the fitted samples: {rounded(fit)} {unit}."
    )


def caution(calibration) -> str:
    """Limits of the held-out numbers: choice of stages, suspect samples, noise."""
    words = []
    if calibration.held_out.get("folds", 0) > 1 and len(calibration.stages) > 1:
        words.append(
            "The same folds decided which stages are kept. For an unbiased number, name test samples that take "
            "no part in this choice."
        )
    suspects = len(calibration.suspects)
    if suspects:
        words.append(
            f"Not part of the fit and of these numbers: {counted(suspects, 'sample')} "
            f"(number {_listed_numbers(calibration.suspects)})."
        )
    noise = getattr(calibration, "noise", None)
    words.extend(noise.warnings if noise is not None else ())
    return " ".join(words)


def _listed_numbers(numbers):
    if len(numbers) > 12:
        unlisted = f" and {len(numbers) - 12} more"
    else:
        unlisted = ""
    return ", ".join(map(str, numbers[:12])) + unlisted
