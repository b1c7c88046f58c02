"""Prediction of a recording by a calibrated arm that was not fitted to it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.recording import Recording
from datasets.samples.columns import joint_columns
from datasets.samples.group_names import numbered_as
from robot_model import load_robot
from robot_model.measurements import measurement_of, samples_of
from robot_model.measurements.ball_scan import file_kind
from robot_model.system import bind
from workbench.core.distributions import fisher
from workbench.core.errors import InputError
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.text.csv_text import csv_text
from workbench.files.solution_file import CalibratedArm
from workbench.fitting.ball_scans import as_scans
from workbench.fitting.checked_samples import check_samples
from workbench.fitting.cross_validation import error_summary
from workbench.fitting.plausibility.fitting import base_and_tool, base_patterns, tool_patterns
from workbench.fitting.verdicts.verdict import Noise, Residual, Tolerance, Verdict, combine, judge
from workbench.jobs.robot import evaluate_sentences as texts
from workbench.jobs.robot.compensation.compensate import covariates_read
from workbench.jobs.robot.compensation.model_error import noise_factor, stated_source
from workbench.jobs.robot.fitted_range import columns_outside
from workbench.jobs.robot.session_clock import clock_warning, is_same_recording, on_session_clock

REFITS = ("none", "base", "tool", "base-and-tool")
"""What is estimated again on the recording: where the instrument stands, what is on the flange, or both."""
_BINS = 3
_MOVED_LEVEL = 1e-3
"""Chance of the better fit with another base and tool from which on neither has moved."""
_MATERIAL = 1.25
"""Ratio of the error to that with another base and tool up to which the difference does not matter."""
_EXPLAINED = 3.0
"""Error with base and tool estimated, in held-out errors of the calibration, that a move alone may leave."""
_SIGNIFICANT = 3.1  # standard deviations that chance exceeds once in a thousand times
_LOAD = "payload_kg"


@dataclass(frozen=True)
class Evaluated:
    """Errors of fixed models on the n moving rows of a recording.

    `residual` (m, n) of the calibrated arm, mm and then rad, with the parameters of `refit` estimated on the
    recording. `nominal` (m, n): of the nominal arm, whose base and tool are always estimated on it. `refitted`
    (m, n): of the calibrated arm with base and tool estimated on it. `out_of_range`: covariates and joint readings
    beyond the range of the calibration. `parameter_spread`: C J' J (F, F), mm^2, with the covariance C of the F
    parameters of the calibration and the derivative J of the lengths with respect to them. `estimated`,
    `most_estimated`: numbers of parameters of `refit`, and of base and tool.
    """

    recording: Recording
    arm: CalibratedArm
    refit: str
    residual: np.ndarray
    nominal: np.ndarray
    refitted: np.ndarray
    out_of_range: tuple[str, ...]
    parameter_spread: np.ndarray
    estimated: int
    most_estimated: int

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
        sentences = [*self.recording.warnings]
        if self.is_fitted_data:
            count, samples = int(self.fitted.sum()), self.recording.n
            share = "this recording" if count == samples else f"{count} of these {samples} samples"
            sentences.append(texts.FITTED.format(share=share))
        if self._fits_better_elsewhere():
            sentences.append(self._better_elsewhere())
        if self.out_of_range:
            sentences.append(
                f"Beyond the range of the calibration: {', '.join(self.out_of_range)}. The model is extrapolated there."
            )
        return tuple(sentences)

    @property
    def is_fitted_data(self) -> bool:
        """Whether the calibration was fitted to some of the samples, of the very files of this recording."""
        return bool(self.fitted.any())

    @property
    def fitted(self) -> np.ndarray:
        """(n,) bool: samples that the calibration was fitted to."""
        if not is_same_recording(self.arm, self.recording):
            return np.zeros(self.recording.n, bool)
        runs, numbers = self.arm.fitted_samples, self.recording.sample_ids
        if runs is None:  # an older version wrote the file
            return np.ones(len(numbers), bool)
        return _is_in_runs(numbers, runs)

    def _fits_better_elsewhere(self) -> bool:
        """Whether another base and tool explain materially more than chance does: F test of nested models.

        And more than noise and uncertainty of the calibration let expect: a part of the latter acts like a move.
        """
        if self.refit != "none" or not self._is_improvement_significant():
            return False
        fixed, refitted = self._squares(self.residual), self._squares(self.refitted)
        degrees = self._coordinates - self.most_estimated
        if fixed / self._coordinates <= _MATERIAL**2 * refitted / degrees:
            return False
        improvement = max(fixed - refitted, 0.0) / self.most_estimated
        statistic = improvement / max(refitted / degrees, 1e-300)
        return fisher.sf(statistic, self.most_estimated, degrees) < _MOVED_LEVEL

    def _is_improvement_significant(self) -> bool:
        """Whether base and tool estimated on the recording take up more than noise and calibration let expect."""
        mean, spread = self._expected_squares(self.most_estimated)
        improvement = self._squares(self.residual) - self._squares(self.refitted)
        return bool(improvement > mean + _SIGNIFICANT * spread)

    @property
    def _has_moved(self) -> bool:
        """Whether a move of instrument or target explains the error: what is left is like the calibration's own."""
        if not self._fits_better_elsewhere():
            return False
        degrees = self._coordinates - self.most_estimated
        unbiased = np.sqrt(self._squares(self.refitted) / degrees * len(self.residual[:3]))
        return bool(unbiased <= _EXPLAINED * self.arm.keys["held_out"]["rms_mm"])

    def _better_elsewhere(self) -> str:
        """Sentence on a better fit with another base and tool, and what to do."""
        errors, refitted = error_summary(self.residual), error_summary(self.refitted)
        text = (
            f"The RMS position error is {errors['rms_mm']:.3g} mm with base and tool of the calibration, and "
            f"{refitted['rms_mm']:.3g} mm with both estimated on this recording"
        )
        if self._has_moved:
            return f"{text}: {texts.MOVED}."
        held_out = self.arm.keys["held_out"]["rms_mm"]
        return f"{text}: {texts.NOT_MOVED.format(held_out=held_out)}"

    @property
    def _coordinates(self) -> int:
        """Number of measured lengths."""
        return self.residual[:3].size

    def _squares(self, residual: np.ndarray) -> float:
        """Sum of squares of the lengths, mm^2."""
        return float((residual[:3] ** 2).sum())

    def verdict(self, tolerances: Sequence[Tolerance] = ()) -> Verdict:
        """RMS errors against the tolerances and, where the recording states it, against the noise.

        An error with base or tool estimated on the recording is enlarged by sqrt(N / (N - p)) for N coordinates and p
        estimated parameters, which take up their share of it.
        """
        errors = error_summary(self.residual)
        degrees = self._coordinates - self.estimated
        share = float(np.sqrt(self._coordinates / degrees))
        noise, is_significant = self._expected(errors["rms_mm"] * share)
        position = Residual(
            errors["rms_mm"] * share,
            name=self._statistic("position", share),
            degrees=degrees,
            is_significant=is_significant,
        )
        advice = texts.MOVED if self._has_moved else texts.ADVICE
        verdicts = [judge(position, noise, tolerances, advice)]
        if "rotation_rms_deg" in errors:
            angle = Residual(
                errors["rotation_rms_deg"] * share,
                "deg",
                self._statistic("orientation", share),
                has_noise=False,
            )
            verdicts.append(judge(angle, None, tolerances, advice))
        verdict = combine(verdicts)
        notes = texts.refit_sentences(self.refitted, self.nominal, self._fits_better_elsewhere())
        return replace(verdict, sentence=" ".join((verdict.sentence, *notes)))

    def _statistic(self, quantity: str, share: float) -> str:
        """Name of the error that is judged."""
        data = "the fitted recording" if self.is_fitted_data else "a recording that was not fitted"
        enlarged = ", enlarged for the parameters estimated on it" if share > 1 else ""
        return f"RMS {quantity} error on {data}{enlarged}"

    def _expected(self, rms: float) -> tuple[Noise | None, bool | None]:
        """RMS error to expect from noise and calibrated parameters, and whether `rms`, mm, is significantly above it.

        With p parameters estimated on the recording N - p of its N coordinates are left, see `_expected_squares`.
        `rms` and the result are enlarged by sqrt(N / (N - p)). None where the noise is not stated.
        """
        if self.recording.sigma is None:
            return None, None
        count, samples = self._coordinates, self.residual.shape[1]
        degrees = count - self.estimated
        mean, spread = self._expected_squares(degrees)
        squares = rms**2 * samples * degrees / count
        is_significant = bool((squares - mean) / max(spread, 1e-300) > _SIGNIFICANT)
        expected = float(np.sqrt(mean / samples * count / degrees))
        source = f"{stated_source(self.arm, self.recording.sigma)}, with the uncertainty of the calibration"
        return Noise(expected, source), is_significant

    def _expected_squares(self, degrees: int) -> tuple[float, float]:
        """Mean and standard deviation of a sum of squares (mm^2) of noise with k degrees of freedom and of parameters.

        k s^2 + tr S and sqrt(2 (k s^4 + 2 s^2 tr S + tr S^2)), with the noise s of a coordinate and S = J C J'.
        """
        variance = self._noise_variance()
        parameters = float(np.trace(self.parameter_spread))
        squared_spread = float(np.sum(self.parameter_spread * self.parameter_spread.T))
        spread = np.sqrt(2 * (degrees * variance**2 + 2 * variance * parameters + squared_spread))
        return degrees * variance + parameters, float(spread)

    def _noise_variance(self) -> float:
        """Variance of a coordinate, mm^2: stated, or else of what remains with base and tool estimated."""
        if self.recording.sigma is None:
            return self._squares(self.refitted) / (self._coordinates - self.most_estimated)
        sigma = noise_factor(self.arm, self.recording.sigma) * self.recording.sigma
        return float(np.mean(np.square(sigma)))

    def as_json(self, tolerances: Sequence[Tolerance] = ()) -> dict:
        """The answer of `workbench evaluate`."""
        return {
            "command": "evaluate",
            "recording": self.recording.name,
            "calibrated_on": self.arm.keys.get("recording"),
            "measures": file_kind(self.recording.measures),
            "samples": self.recording.n,
            "refit": self.refit,
            "error": error_summary(self.residual),
            "nominal": error_summary(self.nominal),
            "refitted": error_summary(self.refitted),
            "held_out": self.arm.keys["held_out"],
            "by_joint": self.by_joint(),
            "warnings": list(self.warnings),
            "verdict": self.verdict(tolerances).as_json(),
        }

    def by_joint(self) -> list[dict]:
        """RMS error in mm in each third of the readings of each joint that moves; None in an empty third."""
        columns = self.recording.columns
        moving = [name for name in joint_columns(columns) if np.ptp(columns[name]) > 0]
        return [{"joint": name, **_by_thirds(columns[name], self.distances)} for name in moving]


def evaluate(
    arm: CalibratedArm,
    recording: Recording,
    refit: str = "none",
    trust_data: bool = False,
    later: bool = False,
) -> Evaluated:
    """Errors of a calibrated arm on a recording that it was not fitted to; the geometry and all effects are fixed.

    refit: one of `REFITS`. trust_data: also for data that are implausible. later: all samples were measured after those
    of the calibration, whatever their times. Raises InputError where the recording
    states another arm, lacks a covariate of an effect, has too few samples, cannot be right, or measures targets that
    the calibration does not know.
    """
    if refit not in REFITS:
        raise InputError(f"--refit {refit}: expected {' or '.join(REFITS)}; correct it.")
    if recording.n == 0:
        raise InputError(f"recording '{recording.name}': expected samples, found none; add rows.")
    samples = numbered_as(samples_of(recording), arm.keys.get("group_names", {}))
    _check_arm(arm, samples)
    samples = as_scans(samples)
    _check_covariates(arm, samples)
    refits_both = base_and_tool(samples)
    max_count = _count(arm, samples, refits_both)
    nominal = _predicted(replace(arm, values={}), samples, (), refits_both)
    _check_number(samples, len(nominal[:3]), max_count)
    warnings = check_samples(recording, trust_data).suspicions
    if not later and (clock_doubt := clock_warning(arm, samples)):
        warnings = (*warnings, clock_doubt)
    recording = replace(samples, warnings=tuple(dict.fromkeys((*samples.warnings, *warnings))))
    samples = on_session_clock(arm, samples, later)
    free = _patterns(samples, refit)
    residual = _predicted(arm, samples, arm.effects, free)
    return Evaluated(
        recording,
        arm,
        refit,
        residual,
        nominal,
        _predicted(arm, samples, arm.effects, refits_both),
        columns_outside(arm, samples),
        _parameter_spread(arm, samples, free),
        _count(arm, samples, free),
        max_count,
    )


def _by_thirds(readings: np.ndarray, distances: np.ndarray) -> dict:
    """Ends of the thirds of readings (n,), and the RMS of the distances (n,) mm in each."""
    edges = np.quantile(readings, np.linspace(0, 1, _BINS + 1))
    place = np.clip(np.searchsorted(edges, readings, "right") - 1, 0, _BINS - 1)
    rms = [_rms(distances[place == k]) for k in range(_BINS)]
    return {"edges": edges.tolist(), "rms_mm": rms}


def _is_in_runs(numbers: np.ndarray, runs: np.ndarray) -> np.ndarray:
    """(n,) bool: numbers (n,) that lie in one of the runs (k, 2) of first and last number, in ascending order."""
    if not len(runs):
        return np.zeros(len(numbers), bool)
    nearest = np.searchsorted(runs[:, 0], numbers, "right") - 1
    return (nearest >= 0) & (numbers <= runs[nearest, 1])


def _check_arm(arm: CalibratedArm, samples: Recording) -> None:
    """InputError where the recording states another nominal geometry than that of the calibration."""
    stated = load_robot(samples.robot, f"robot of {samples.name}")
    if stated.joints != arm.robot.joints:
        raise InputError(
            f"recording '{samples.name}': expected the arm of the calibration with {arm.robot.joints} joints, found "
            f"one with {stated.joints}; evaluate a recording of the same arm."
        )
    if not np.allclose(stated.geometry, arm.robot.geometry, rtol=0, atol=1e-6):
        raise InputError(
            f"recording '{samples.name}', robot: expected the nominal geometry of the arm of the calibration "
            f"({arm.robot.name}), found another one ({stated.name}); correct the robot of the recording, or evaluate "
            "a recording of the same arm."
        )


def _check_covariates(arm: CalibratedArm, samples: Recording) -> None:
    """InputError where a column is missing on which the model depends."""
    fitted = arm.fitted_range or {}
    needed = set(covariates_read(arm))
    if _LOAD in fitted and any(effect.elastic for effect in arm.acting_effects):
        needed.add(_LOAD)
    for name in sorted(needed - set(samples.columns)):
        low, high = fitted[name]
        raise InputError(
            f"recording '{samples.name}', samples.csv: expected column {name}, on which the calibrated model depends "
            f"({low:.4g} to {high:.4g} in its recording), found none; add it."
        )


def _check_number(samples: Recording, per_pose: int, count: int) -> None:
    """InputError where so few coordinates, `per_pose` a pose, are measured that base and tool (`count`) fit all."""
    poses = len(np.unique(samples.poses))
    if per_pose * poses <= count:
        raise InputError(
            f"recording '{samples.name}': expected at least {count // per_pose + 1} poses, found {poses}: base and "
            f"tool have {count} parameters, so that fewer fit any arm; measure more."
        )


def _count(arm: CalibratedArm, samples: Recording, free: tuple[str, ...]) -> int:
    """Number of parameters that match some patterns."""
    if not free:
        return 0
    parameters = Model(bind(arm.robot, samples, None), arm.effects).parameters
    return int(parameters.matching(*free).sum())


def _patterns(samples: Recording, refit: str) -> tuple[str, ...]:
    tool = tool_patterns(samples)
    base = base_patterns(samples)
    return {"none": (), "base": base, "tool": tool, "base-and-tool": (*base, *tool)}[refit]


def _model(
    arm: CalibratedArm, samples: Recording, effects: tuple, free: tuple[str, ...]
) -> tuple[Model, Parameters]:
    """Model of the samples and its parameters at the values of the arm; those that match `free` are at their start."""
    model = Model(bind(arm.robot, samples, _start(arm, samples, free)), effects)
    if arm.values:
        state = replace(model.chain.state, load_centre=arm.load_centre)
        model = replace(model, chain=replace(model.chain, state=state))
    return model, _with_values(arm, model.parameters, free)


def _predicted(
    arm: CalibratedArm, samples: Recording, effects: tuple, free: tuple[str, ...]
) -> np.ndarray:
    """(m, n) residual at the values of the arm, parameters that match `free` estimated on the samples."""
    model, parameters = _model(arm, samples, effects, free)
    if free:
        fit = solve(model, parameters.only(parameters.matching(*free)))
        if model.chain.sigma_unknown:
            fit = solve(_with_estimated_sigma(model, fit.residual), fit.parameters)
        parameters = fit.parameters
    return model.residual(parameters)


def _with_estimated_sigma(model: Model, residual: np.ndarray) -> Model:
    """The model with the RMS of the residual (m, n) as the sigma of a length; those of angles stay."""
    sigma = model.chain.sigma.copy()
    sigma[:3] = max(_rms(residual[:3]), 1e-6)
    return replace(model, chain=replace(model.chain, sigma=sigma), _bases={})


def _parameter_spread(arm: CalibratedArm, samples: Recording, free: tuple[str, ...]) -> np.ndarray:
    """C J' J (F, F), mm^2, of the parameters that the calibration estimated and that do not match `free`.

    What parameters that match `free` take up, estimated on the samples, is projected out of J.
    """
    model, parameters = _model(arm, samples, arm.effects, free)
    refitted = parameters.matching(*free) if free else np.zeros(len(parameters), bool)
    known = {key: place for place, key in enumerate(arm.free)}
    estimated = np.array([key in known for key in parameters.keys]) & ~refitted
    columns = _lengths_by(model, parameters.only(estimated))
    if refitted.any():
        basis = _orthonormal_basis(_lengths_by(model, parameters.only(refitted)))
        columns = columns - basis @ (basis.T @ columns)
    keys = [key for key, is_one in zip(parameters.keys, estimated) if is_one]
    places = [known[key] for key in keys]
    return arm.covariance[np.ix_(places, places)] @ (columns.T @ columns)


def _lengths_by(model: Model, parameters: Parameters) -> np.ndarray:
    """(N, F) derivative of the lengths with respect to the free parameters."""
    _, rows = model.linearise(parameters)
    return rows[:, :3].reshape(len(rows), -1).T


def _orthonormal_basis(columns: np.ndarray) -> np.ndarray:
    """(N, R) orthonormal basis of what columns (N, F) make."""
    scaled = columns / np.maximum(np.sqrt((columns**2).sum(0)), 1e-300)
    u, sizes, _ = np.linalg.svd(scaled, full_matrices=False)
    return u[:, sizes > 1e-9]


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


def lengths(residual: np.ndarray) -> np.ndarray:
    """(n,) mm of a residual (m, n)."""
    return np.sqrt((residual[:3] ** 2).sum(0))


def _rms(values: np.ndarray) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


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
