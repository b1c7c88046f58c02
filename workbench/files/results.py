"""Answer and files of a calibration: the JSON contract, tables and files."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from robot_model.effects.curve import describe_curves
from robot_model.measurements.ball_scan import file_kind
from robot_model.stiffness import stiffness_rows


@dataclass(frozen=True)
class StageResult:
    """Errors of one stage; `earned` False: cross-validation does not retain it.

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


ESTIMATED, NOT_IDENTIFIABLE, FIXED, AT_ZERO = "estimated", "not identifiable", "held", "at zero"
"""Values of `status` of a parameter in the JSON."""
_WITHOUT_NOMINAL = ("base", "tool", "sensor", "artefact")


_AT_ZERO = {
    "status": AT_ZERO,
    "why": "held at zero: it cannot be negative, and a negative value would fit better",
}


def parameter_rows(solution) -> list[dict]:
    """One row per parameter of the JSON contract.

    `status`: "estimated" with a standard deviation; "at zero" where the parameter cannot be negative and its
    estimate is, so that it is held at zero; "not identifiable" where the data do not determine
    the parameter, which is then free and confounded with others, or held at nominal because others
    carry it; "held" where the plan holds it at nominal. `deviation` from nominal in the parameter's
    unit, None for poses and points of which nothing is known before the calibration. `std` allows for
    parameters that are held because others carry them: they are uncertain by their priors. A parameter that
    is identifiable only together with others has no `std` but `std_given_tied`: its standard deviation
    if those others are exactly at the values that they are held at. The rule is that of
    `workbench.core.least_squares.single_parameters`.
    """
    parameters, single = solution.parameters, solution.single
    known = frozenset(single.known.keys)
    is_determined = solution.determined
    tied, std = single.tied(), _standard_deviations(solution)
    rows = []
    for p, value, free in zip(
        parameters.table, parameters.values.tolist(), parameters.mask.tolist()
    ):
        determination = std.get(p.key), p.key in is_determined, p.key in known
        row = _row(p, value, free, determination, tied.get(p.key, []))
        rows.append(row | _AT_ZERO if p.key in solution.at_zero else row)
    return rows


def _standard_deviations(solution) -> dict[str, float]:
    """Key -> std of determined parameters, of others that with the held ones exactly at their values."""
    if solution.redundancy <= 0:
        return {}
    is_determined = solution.determined
    return solution.std | {
        key: value for key, value in solution.marginal_std.items() if key in is_determined
    }


def _row(parameter, value, free, determination, others):
    """judged: (std or None, whether determined by itself, whether any stage asks about it)."""
    where, _, name = parameter.key.partition(".")
    std, determined, is_asked = determination
    is_determined = bool(free and determined and std is not None)
    return {
        "name": name,
        "where": where,
        "value": value,
        "unit": parameter.unit,
        "std": std if is_determined else None,
        "nominal": parameter.null,
        "identifiable": is_determined,
        "tied_to": others,
        "free": bool(free),
        "label": parameter.label,
        "std_given_tied": None if is_determined else std,
        "why": _why(free, is_determined, std, others, is_asked, value == parameter.null),
        "status": _status(free, is_determined, others),
        "deviation": _deviation(where, name, value, parameter.null),
    }


def _status(free: bool, is_determined: bool, others: list[str]) -> str:
    if is_determined:
        return ESTIMATED
    return NOT_IDENTIFIABLE if free or others else FIXED


def _deviation(where: str, name: str, value: float, nominal: float) -> float | None:
    """From nominal; effects (whose names hold a point) have the nominal value zero wherever they act."""
    has_nominal = where not in _WITHOUT_NOMINAL or "." in name
    return value - nominal if has_nominal else None


def _why(free, is_determined, std, others, is_asked, is_nominal):
    if is_determined:
        return ""
    if free and std is None:
        return "no redundancy: as many parameters as measured numbers"
    if free:
        if others:
            return "not identifiable: confounded with " + ", ".join(others)
        return "not identifiable: too small an effect on these measurements"
    if others:
        place = "nominal" if is_nominal else "the value of a fit of all"
        return f"not identifiable, held at {place}: confounded with " + ", ".join(others)
    if not is_asked:
        return "held at its nominal value by the plan"
    return "held at nominal: too small an effect on these measurements"


def calibration_json(calibration) -> dict:
    """The answer of `workbench calibrate`, keys as the contract fixes them, more added."""
    solution = calibration.solution
    known = solution.known
    return {
        "command": "calibrate",
        "recording": calibration.recording.name,
        "measures": file_kind(calibration.recording.measures),
        "samples": calibration.recording.n,
        "group_names": dict(calibration.recording.group_names),
        "stages": [_stage_row(stage) for stage in calibration.stages],
        "parameters": [dict(row) for row in calibration.parameters],
        "fit": calibration.fit,
        "held_out": calibration.held_out,
        "nominal": calibration.nominal,
        "converged": solution.converged,
        "outcome": solution.outcome,
        "joint_curves": describe_curves(calibration.model, solution.parameters),
        "stiffness": calibration.stiffness,
        "terms": calibration.terms,
        "undetermined": list(solution.null_sentences),
        "observability": known.observability(calibration.recording.n),
        "suspect_samples": list(calibration.suspects),
        "warnings": [*calibration.warnings, *calibration.noise.warnings],
        "noise": calibration.noise.as_json(),
        "selection": "stages were chosen on folds of the fit samples; without named test samples these give held_out",
        "provenance": calibration.provenance,
    }


def joint_stiffness(calibration) -> list[dict]:
    """Which joint stiffness is known in N m/rad, and which only times a first moment."""
    solution = calibration.solution
    known = _standard_deviations(solution)
    std = {key: known[key] for key in known if key in solution.determined}
    rows = stiffness_rows(calibration.model, solution.parameters, std)
    return [row.as_json() for row in rows]


_STAGE_KEYS = (
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


def _stage_row(stage: StageResult) -> dict:
    row = {key: getattr(stage, key) for key in _STAGE_KEYS}
    if stage.held_out_rotation_rms_deg is not None:
        row["rotation_rms_deg"] = stage.rotation_rms_deg
        row["held_out_rotation_rms_deg"] = stage.held_out_rotation_rms_deg
    return row


def save_calibration(calibration, folder: Path) -> None:
    """Write parameters.toml, residuals.csv, calibration.json and solution.json."""
    from workbench.files.solution_file import NAME, solution_keys

    (folder / NAME).write_text(json.dumps(solution_keys(calibration), indent=1), encoding="utf-8")
    (folder / "parameters.toml").write_text(
        calibration.solution.parameters.to_toml(), encoding="utf-8"
    )
    text = json.dumps(calibration.as_json(), indent=1, allow_nan=True)
    (folder / "calibration.json").write_text(text, encoding="utf-8")
    save_arrows(calibration, folder)
    columns = _residual_columns(calibration)
    table = np.stack([np.asarray(c, float) for c in columns.values()], 1)
    np.savetxt(
        folder / "residuals.csv",
        table,
        fmt="%.6g",
        delimiter=",",
        header=",".join(columns),
        comments="",
    )


ARROWS = "residual-arrows.parquet"


def save_arrows(calibration, folder: Path) -> None:
    """Write residual-arrows.parquet: measured points and residuals in the robot's root frame, mm, one row a sample.

    Columns sample, pose, x_mm, y_mm, z_mm and dx_mm, dy_mm, dz_mm: the held-out residual where there is one, else
    that of the fit.
    """
    recording = calibration.recording
    columns = {"sample": recording.sample_ids, "pose": recording.poses}
    columns |= _axis_columns("", calibration.points)
    columns |= _axis_columns("d", calibration.residual_in_root)
    _write_parquet(columns, folder / ARROWS)


def _axis_columns(prefix: str, rows) -> dict[str, np.ndarray]:
    """Columns `prefix`x_mm, y_mm, z_mm of rows (3, n)."""
    return {f"{prefix}{axis}_mm": row for axis, row in zip("xyz", np.asarray(rows, float))}


def _write_parquet(columns: dict[str, np.ndarray], path: Path) -> None:
    """Write columns (n,) of numbers as Parquet with page checksums.

    From their memory: pyarrow imports pandas to find out what an array is, a quarter of a second in every command.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays = list(map(_arrow_array, columns.values()))
    table = pa.Table.from_arrays(arrays, names=list(columns))
    pq.write_table(table, path, write_page_checksum=True)


def _arrow_array(values: np.ndarray):
    """A pyarrow array of numbers (n,) that shares their memory."""
    import pyarrow as pa

    contiguous = np.ascontiguousarray(values)
    kind = pa.from_numpy_dtype(contiguous.dtype)
    return pa.Array.from_buffers(kind, len(contiguous), [None, pa.py_buffer(contiguous)])


def _residual_columns(calibration):
    """Column name -> (n,): position residuals in mm, then rotation residuals in degrees where there are any."""
    columns = {"sample": calibration.recording.sample_ids, "fold": calibration.fold}
    for name in ("fit", "held_out", "nominal"):
        columns |= _axis_columns(f"{name}_", getattr(calibration, f"{name}_residual"))
    for name, residual in calibration.rotation.items():
        columns |= {f"{name}_{axis}_deg": row for axis, row in rotation_columns(residual).items()}
    return columns


def rotation_columns(residual: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of a table for rotation residuals (k, n) in rad: name -> (n,) deg.

    "rx", "ry", "rz" of the rotation vector; "axis", the angle, where one axis is measured (k = 2): its
    two components are in a frame that differs from sample to sample, so only their length has a meaning.
    """
    degrees = np.rad2deg(residual)
    if len(residual) == 2:
        return {"axis": np.sqrt((degrees**2).sum(0))}
    return dict(zip(("rx", "ry", "rz"), degrees))
