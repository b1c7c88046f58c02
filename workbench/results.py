"""What a calibration answers and leaves on disk: the JSON contract, tables and files."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class StageResult:
    """How one stage fared; `earned` False: it did not lower the held-out error and was left out."""

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


def parameter_rows(solution) -> list[dict]:
    """One row a parameter of the JSON contract; what is undetermined carries no sigma."""
    parameters, known = solution.parameters, solution.known
    determined = dict(zip(known.keys, known.determined.tolist()))
    tied = known.tied() | dict(solution.tied)
    return [
        _row(p, value, free, solution.std, determined, tied)
        for p, value, free in zip(parameters.table, parameters.values.tolist(), parameters.mask.tolist())
    ]


def _row(parameter, value, free, std, determined, tied):
    key = parameter.key
    where, _, name = key.partition(".")
    sure = free and determined[key]
    others = tied.get(key, [])
    return {
        "name": name, "where": where, "value": value, "unit": parameter.unit,
        "std": std[key] if sure else None, "nominal": parameter.null, "identifiable": bool(sure),
        "tied_to": others, "free": bool(free), "label": parameter.label, "why": _why(free, sure, others, key in tied),
    }  # fmt: skip


def _why(free, sure, others, held):
    if sure:
        return ""
    if free:
        return (
            "undetermined: one and the same here as " + ", ".join(others)
            if others
            else "undetermined: has no effect here"
        )
    if held:
        return "held: what it does is already done by " + ", ".join(others) if others else "held: has no effect here"
    return "held at its nominal value by the plan"


def calibration_json(calibration) -> dict:
    """The answer of `workbench calibrate`, keys as the contract fixes them, more added."""
    solution = calibration.solution
    stages = [
        {
            k: getattr(s, k)
            for k in (
                "name",
                "free",
                "identifiable",
                "rms_mm",
                "held_out_rms_mm",
                "earned",
                "sentence",
                "why",
                "outcome",
            )
        }
        for s in calibration.stages
    ]
    known = solution.known
    return {
        "command": "calibrate",
        "recording": calibration.recording.name,
        "measures": calibration.recording.measures,
        "samples": calibration.recording.n,
        "stages": stages,
        "parameters": [dict(row) for row in calibration.parameters],
        "fit": calibration.fit,
        "held_out": calibration.held_out,
        "nominal": calibration.nominal,
        "converged": solution.converged,
        "outcome": solution.outcome,
        "undetermined": list(solution.null_sentences),
        "observability": known.observability(calibration.recording.n),
        "suspect_samples": list(calibration.suspects),
        "selection": "stages were chosen on folds of the fit samples; without named test samples these give held_out",
        "provenance": calibration.provenance,
    }


def save_calibration(calibration, folder: Path) -> None:
    """Write parameters.toml, residuals.csv and calibration.json."""
    (folder / "parameters.toml").write_text(calibration.solution.parameters.to_toml(), encoding="utf-8")
    text = json.dumps(calibration.as_json(), indent=1, allow_nan=True)
    (folder / "calibration.json").write_text(text, encoding="utf-8")
    columns = _residual_columns(calibration)
    table = np.stack([np.asarray(c, float) for c in columns.values()], 1)
    np.savetxt(folder / "residuals.csv", table, fmt="%.6g", delimiter=",", header=",".join(columns), comments="")


def _residual_columns(calibration):
    columns = {"sample": calibration.recording.sample_ids, "fold": calibration.fold}
    for name in ("fit", "held_out", "nominal"):
        rows = getattr(calibration, f"{name}_residual")
        columns |= {f"{name}_{axis}_mm": row for axis, row in zip("xyz", rows)}
    return columns
