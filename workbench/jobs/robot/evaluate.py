"""Prediction of a recording by a calibrated arm that was not fitted to it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.columns import joint_columns
from datasets.recording import Recording
from robot_model.measurements import measurement_of, samples_of
from robot_model.system import bind
from workbench.core.errors import InputError
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.text.csv_text import csv_text
from workbench.files.solution_file import CalibratedArm
from workbench.fitting.cross_validation import error_summary
from workbench.fitting.plausibility.fitting import base_and_tool, tool_patterns
from workbench.fitting.verdicts.verdict import Noise, Residual, Tolerance, Verdict, combine, judge

REFITS = ("none", "base", "tool", "base-and-tool")
"""What is estimated again on the recording: where the instrument stands, what is on the flange, or both."""
_BINS = 3
_MOVED = 2.0
_ADVICE = (
    "the model does not describe this recording as well as its noise allows; run `workbench diagnose` on it, or "
    "calibrate with both recordings"
)


@dataclass(frozen=True)
class Evaluated:
    """Errors of fixed models on the n moving rows of a recording.

    `residual` (m, n) of the calibrated arm, mm and then rad, with the parameters of `refit` estimated on the
    recording. `nominal` (m, n): of the nominal arm, whose base and tool are always estimated on it. `with_base`
    (m, n): of the calibrated arm with base and tool estimated on it. `outside`: covariates and joint readings beyond
    the range of the calibration.
    """

    recording: Recording
    arm: CalibratedArm
    refit: str
    residual: np.ndarray
    nominal: np.ndarray
    with_base: np.ndarray
    outside: tuple[str, ...]

    @property
    def distances(self) -> np.ndarray:
        """(n,) mm, 3-D errors of the calibrated arm."""
        return lengths(self.residual)

    @property
    def nominal_distances(self) -> np.ndarray:
        """(n,) mm, 3-D errors of the nominal arm."""
        return lengths(self.nominal)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences on what limits the comparison."""
        said = [*self.recording.warnings]
        errors, refitted = error_summary(self.residual), error_summary(self.with_base)
        if self.refit == "none" and errors["rms_mm"] > _MOVED * refitted["rms_mm"]:
            said.append(
                f"The RMS position error is {errors['rms_mm']:.3g} mm with base and tool of the calibration, and "
                f"{refitted['rms_mm']:.3g} mm with both estimated on this recording: the instrument or the target has "
                "moved since. Repeat with --refit base, tool or base-and-tool."
            )
        if self.outside:
            said.append(
                f"Beyond the range of the calibration: {', '.join(self.outside)}. The model is extrapolated there."
            )
        return tuple(said)

    def verdict(self, tolerances: Sequence[Tolerance] = ()) -> Verdict:
        """RMS errors against the tolerances and, where the recording states it, against the noise."""
        errors = error_summary(self.residual)
        sigma = self.recording.sigma
        noise = None if sigma is None else Noise(float(np.sqrt(3 * np.mean(np.square(sigma)))))
        parts = [judge(_residual(errors, "rms_mm", "position"), noise, tolerances, _ADVICE)]
        if "rotation_rms_deg" in errors:
            angle = replace(
                _residual(errors, "rotation_rms_deg", "orientation"), unit="deg", has_noise=False
            )
            parts.append(judge(angle, None, tolerances, _ADVICE))
        return combine(parts)

    def as_json(self, tolerances: Sequence[Tolerance] = ()) -> dict:
        """The answer of `workbench evaluate`."""
        return {
            "command": "evaluate",
            "recording": self.recording.name,
            "calibrated_on": self.arm.keys.get("recording"),
            "measures": self.recording.measures,
            "samples": self.recording.n,
            "refit": self.refit,
            "error": error_summary(self.residual),
            "nominal": error_summary(self.nominal),
            "refitted": error_summary(self.with_base),
            "held_out": self.arm.keys["held_out"],
            "by_joint": self.by_joint(),
            "warnings": list(self.warnings),
            "verdict": self.verdict(tolerances).as_json(),
        }

    def by_joint(self) -> list[dict]:
        """RMS error in mm in the low, middle and high third of the readings of each joint."""
        rows = []
        for name in joint_columns(self.recording.columns):
            values = self.recording.columns[name]
            edges = np.quantile(values, np.linspace(0, 1, _BINS + 1))
            place = np.clip(np.searchsorted(edges, values, "right") - 1, 0, _BINS - 1)
            rms = [_rms(self.distances[place == k]) for k in range(_BINS)]
            rows.append({"joint": name, "edges": edges.tolist(), "rms_mm": rms})
        return rows


def evaluate(arm: CalibratedArm, recording: Recording, refit: str = "none") -> Evaluated:
    """Errors of a calibrated arm on a recording that it was not fitted to; the geometry and all effects are fixed.

    refit: one of `REFITS`. Raises InputError where the recording measures another arm, lacks a covariate of an effect
    or measures targets that the calibration does not know.
    """
    if refit not in REFITS:
        raise InputError(f"--refit {refit}: expected {' or '.join(REFITS)}; correct it.")
    samples = samples_of(recording)
    if samples.n == 0:
        raise InputError(f"recording '{recording.name}': expected samples, found none; add rows.")
    free = _patterns(samples, refit)
    both = base_and_tool(samples)
    return Evaluated(
        samples,
        arm,
        refit,
        _predicted(arm, samples, arm.effects, free),
        _predicted(replace(arm, values={}), samples, (), both),
        _predicted(arm, samples, arm.effects, both),
        _outside(arm, samples),
    )


def _patterns(samples: Recording, refit: str) -> tuple[str, ...]:
    tool = tool_patterns(samples)
    base = () if measurement_of(samples).grounded else ("base.*",)
    return {"none": (), "base": base, "tool": tool, "base-and-tool": (*base, *tool)}[refit]


def _predicted(
    arm: CalibratedArm, samples: Recording, effects: tuple, free: tuple[str, ...]
) -> np.ndarray:
    """(m, n) residual at the values of the arm, parameters that match `free` estimated on the samples."""
    model = Model(bind(arm.robot, samples, _start(arm, samples, free)), effects)
    if arm.values:
        state = replace(model.chain.state, load_centre=arm.load_centre)
        model = replace(model, chain=replace(model.chain, state=state))
    parameters = _with_values(arm, model.parameters, free)
    if free:
        parameters = solve(model, parameters.only(parameters.matching(*free))).parameters
    return model.residual(parameters)


def _start(arm: CalibratedArm, samples: Recording, free: tuple[str, ...]) -> np.ndarray | None:
    """Base and tool of the calibration; None where they are to be estimated, which finds a start in closed form."""
    if free:
        return None
    measurement = measurement_of(samples)
    base = [] if measurement.grounded else [f"base.{n}" for n in ("x", "y", "z", "rx", "ry", "rz")]
    keys = [*base, *(parameter.key for parameter in measurement.parameters())]
    missing = [key for key in keys if key not in arm.values]
    if missing:
        raise _unknown_target(samples, missing[0])
    return np.array([arm.values[key] for key in keys])


def _with_values(arm: CalibratedArm, parameters: Parameters, free: tuple[str, ...]) -> Parameters:
    """The parameters at the values of the calibration; those that match `free` stay at their start."""
    if not arm.values:
        return parameters
    estimated = parameters.matching(*free) if free else np.zeros(len(parameters), bool)
    values = parameters.values.copy()
    for place, key in enumerate(parameters.keys):
        if estimated[place]:
            continue
        if key not in arm.values:
            raise _unknown_target(samples=None, key=key)
        values[place] = arm.values[key]
    return replace(parameters, values=values)


def _unknown_target(samples: Recording | None, key: str) -> InputError:
    where = "the recording" if samples is None else f"recording '{samples.name}'"
    return InputError(
        f"{where}: expected targets that the calibration knows, found that {key} has no value there; repeat with "
        "--refit tool or --refit base-and-tool, or evaluate a recording of the same targets."
    )


def _outside(arm: CalibratedArm, samples: Recording) -> tuple[str, ...]:
    """Columns that leave the range of the calibration, with both ranges."""
    found = []
    for name, (low, high) in (arm.fitted_range or {}).items():
        values = samples.columns.get(name)
        if values is None or name in ("row", "time_s"):
            continue
        slack = 0.05 * (high - low)
        if values.min() < low - slack or values.max() > high + slack:
            found.append(
                f"{name} ({values.min():.4g} to {values.max():.4g}, calibrated {low:.4g} to {high:.4g})"
            )
    return tuple(found)


def lengths(residual: np.ndarray) -> np.ndarray:
    """(n,) mm of a residual (m, n)."""
    return np.sqrt((residual[:3] ** 2).sum(0))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _residual(errors: Mapping[str, float], key: str, what: str) -> Residual:
    return Residual(errors[key], name=f"RMS {what} error on a recording that was not fitted")


def save(evaluated: Evaluated, folder: Path) -> None:
    """Write residuals.csv: residual and distance of the calibrated arm, distance of the nominal one; mm, deg."""
    residual = evaluated.residual
    names = ["dx_mm", "dy_mm", "dz_mm"][: min(3, len(residual))]
    columns = [evaluated.recording.sample_ids, *residual[: len(names)]]
    columns += [evaluated.distances, evaluated.nominal_distances]
    head = ["sample", *names, "distance_mm", "nominal_distance_mm"]
    if len(residual) > 3:
        head.append("rotation_deg")
        columns.append(np.rad2deg(np.sqrt((residual[3:] ** 2).sum(0))))
    rows = [list(row) for row in zip(*columns)]
    (folder / "residuals.csv").write_text(csv_text(head, rows), encoding="utf-8")
