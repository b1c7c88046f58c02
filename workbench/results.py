"""What a calibration answers and leaves on disk: the JSON contract, tables and files."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class StageResult:
    """Errors of one stage; `earned` False: it did not lower the held-out error and was left out.

    The rotation errors are None where the recording measures no orientation.
    """

    name: str
    why: str
    free: int
    identifiable: int
    rms_mm: float
    held_out_rms_mm: float
    earned: bool
    sentence: str
    outcome: str
    history: tuple[float, ...]
    rotation_rms_deg: float | None = None
    held_out_rotation_rms_deg: float | None = None


def parameter_rows(solution) -> list[dict]:
    """One row a parameter of the JSON contract.

    A parameter that is known only together with others carries no `std` but `std_given_tied`: how
    sure it is if those others are exactly what they are held at.
    """
    parameters, known = solution.parameters, solution.all_known
    determined = dict(zip(known.keys, known.determined.tolist()))
    tied = known.tied()
    std = solution.std if solution.redundancy > 0 else {}
    return [
        _row(p, value, free, std.get(p.key), determined.get(p.key, False), tied.get(p.key, []))
        for p, value, free in zip(parameters.table, parameters.values.tolist(), parameters.mask.tolist())
    ]


def _row(parameter, value, free, std, determined, others):
    where, _, name = parameter.key.partition(".")
    sure = bool(free and determined and std is not None)
    return {
        "name": name, "where": where, "value": value, "unit": parameter.unit,
        "std": std if sure else None, "nominal": parameter.null, "identifiable": sure,
        "tied_to": others, "free": bool(free), "label": parameter.label,
        "std_given_tied": None if sure else std, "why": _why(free, sure, std, others, determined),
    }  # fmt: skip


def _why(free, sure, std, others, determined):
    if sure:
        return ""
    if free and std is None:
        return "no redundancy: as many parameters as measured numbers"
    if free:
        return "known only together with " + ", ".join(others) if others else "undetermined: too little effect here"
    if others:
        return "held: one and the same here as " + ", ".join(others)
    return "held at its nominal value by the plan" if determined is False else "held: too little effect here"


def calibration_json(calibration) -> dict:
    """The answer of `workbench calibrate`, keys as the contract fixes them, more added."""
    solution = calibration.solution
    known = solution.known
    return {
        "command": "calibrate",
        "recording": calibration.recording.name,
        "measures": calibration.recording.measures,
        "samples": calibration.recording.n,
        "stages": [_stage_row(stage) for stage in calibration.stages],
        "parameters": [dict(row) for row in calibration.parameters],
        "fit": calibration.fit,
        "held_out": calibration.held_out,
        "nominal": calibration.nominal,
        "converged": solution.converged,
        "outcome": solution.outcome,
        "undetermined": list(solution.null_sentences),
        "observability": known.observability(calibration.recording.n),
        "suspect_samples": list(calibration.suspects),
        "warnings": [*calibration.warnings, *calibration.noise.warnings],
        "noise": calibration.noise.as_json(),
        "selection": "stages were chosen on folds of the fit samples; without named test samples these give held_out",
        "provenance": calibration.provenance,
    }


_STAGE_KEYS = (
    "name", "free", "identifiable", "rms_mm", "held_out_rms_mm", "earned", "sentence", "why", "outcome",
)  # fmt: skip


def _stage_row(stage: StageResult) -> dict:
    row = {key: getattr(stage, key) for key in _STAGE_KEYS}
    if stage.held_out_rotation_rms_deg is not None:
        row["rotation_rms_deg"] = stage.rotation_rms_deg
        row["held_out_rotation_rms_deg"] = stage.held_out_rotation_rms_deg
    return row


def save_calibration(calibration, folder: Path) -> None:
    """Write parameters.toml, residuals.csv, calibration.json and solution.json."""
    from workbench.solution_file import NAME, solution_keys

    (folder / NAME).write_text(json.dumps(solution_keys(calibration), indent=1), encoding="utf-8")
    (folder / "parameters.toml").write_text(calibration.solution.parameters.to_toml(), encoding="utf-8")
    text = json.dumps(calibration.as_json(), indent=1, allow_nan=True)
    (folder / "calibration.json").write_text(text, encoding="utf-8")
    columns = _residual_columns(calibration)
    table = np.stack([np.asarray(c, float) for c in columns.values()], 1)
    np.savetxt(folder / "residuals.csv", table, fmt="%.6g", delimiter=",", header=",".join(columns), comments="")


ROTATION_COLUMNS = {3: ("rx", "ry", "rz"), 1: ("axis",), 0: ()}
"""Number of columns of rotation residuals -> their names: a rotation vector, or the angle between two axes."""


def _residual_columns(calibration):
    """Column name -> (n,): position residuals in mm, then rotation residuals in degrees where there are any."""
    columns = {"sample": calibration.recording.sample_ids, "fold": calibration.fold}
    for name in ("fit", "held_out", "nominal"):
        rows = getattr(calibration, f"{name}_residual")
        columns |= {f"{name}_{axis}_mm": row for axis, row in zip("xyz", rows)}
    for name, residual in calibration.rotation.items():
        rows = np.rad2deg(_rotation_rows(residual))
        columns |= {f"{name}_{axis}_deg": row for axis, row in zip(ROTATION_COLUMNS[len(rows)], rows)}
    return columns


def _rotation_rows(residual: np.ndarray) -> np.ndarray:
    """What a table shows of rotation residuals (k, n): three components, or the angle where one axis is measured.

    The two components across an axis are in a frame that differs from sample to sample, so only their
    length means anything.
    """
    if len(residual) == 2:
        return np.sqrt((residual**2).sum(0))[None]
    return residual
