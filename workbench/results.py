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
        "warnings": list(calibration.warnings),
        "selection": "stages were chosen on folds of the fit samples; without named test samples these give held_out",
        "provenance": calibration.provenance,
    }


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


def _residual_columns(calibration):
    columns = {"sample": calibration.recording.sample_ids, "fold": calibration.fold}
    for name in ("fit", "held_out", "nominal"):
        rows = getattr(calibration, f"{name}_residual")
        columns |= {f"{name}_{axis}_mm": row for axis, row in zip("xyz", rows)}
    return columns
