"""`solution.json`: a calibrated arm on disk, with all that a program needs to use it later."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.samples.columns import BOOKKEEPING, MEASURED, MEASURED_GROUPS, OTHER, joint_columns
from robot_model import load_robot
from robot_model.effects import CATALOGUE
from robot_model.measurements.ball_scan import file_kind
from robot_model.postures.configuration import configuration_signs, has_configurations
from robot_model.robot import Robot
from workbench.core.effect import Effect, make_effects
from workbench.core.errors import InputError
from workbench.core.terms import switched_off, term_names
from workbench.core.text.structured_text import ContentError, read_json
from workbench.files.considered import Considered, read_considered

FORMAT, NAME = "solution/1", "solution.json"
# Largest plausible correction of the position and of the orientation of the flange, where nobody states another.
LARGEST_MM, LARGEST_DEG = 10.0, 1.0
_MOST_READINGS = 100  # poses that show where the arm was recorded
_FRAMES = ("base.", "tool.", "sensor.", "artefact.")  # keys of what stands around the arm
# What acts on the arm. The instrument's own errors, its drift relative to the base and the moment of reading move no
# flange.
_ARM_PORTS = ("joint", "geometry", "frame", "gravity", "mass")


@dataclass(frozen=True)
class CalibratedArm:
    """An arm as a calibration left it.

    `values` of its parameters by key (base, geometry, tool, effects; mm, rad); `free` the F keys
    that were solved for and `covariance` (F, F) of them; `load_centre` (3,) mm on the flange;
    `held_out_mm` RMS of the 3-D error on samples that the solve did not see; `trusted` False where
    it did not converge, the recording was in doubt or the held-out error is no better than the nominal
    arm's, and `why` says so. `fitted_range`: lowest and highest value of every joint reading and covariate that was
    recorded, by column name in file units; None where an older version wrote the file. `discrepancy_mm`: RMS distance
    that the calibration left beyond its noise; 0 where the noise is unknown or an older version wrote the file.
    `considered`: terms of a diagnosis that are not in the model and count for its uncertainty.
    `fitted_samples` (k, 2): first and last number of each run of samples that were fitted; None where an older version
    wrote the file. `rows`: number of rows of the recording; the row is the clock where no time was recorded.
    `recorded_samples` (k, 2): runs of the numbers of all samples in the order of these rows, or None like the others.
    `configurations` (k, 3): signs of the recorded configurations (`postures.configuration`), or None like the
    others and for arms that have no such signs. `recorded_readings` (k, R) rad, mm: of some of the fitted poses, or
    None like the others.
    """

    robot: Robot
    effects: tuple[Effect, ...]
    values: dict[str, float]
    free: tuple[str, ...]
    covariance: np.ndarray
    load_centre: np.ndarray
    held_out_mm: float
    trusted: bool
    why: str
    keys: dict
    fitted_range: Mapping[str, tuple[float, float]] | None = None
    discrepancy_mm: float = 0.0
    considered: Considered | None = None
    fitted_samples: np.ndarray | None = None
    rows: int = 0
    recorded_samples: np.ndarray | None = None
    configurations: np.ndarray | None = None
    recorded_readings: np.ndarray | None = None

    @property
    def is_no_better_than_nominal(self) -> bool:
        """Whether an estimated geometry or effects predict unseen samples no better than the nominal arm."""
        return _is_no_better(self.keys)

    @property
    def acting_effects(self) -> tuple[Effect, ...]:
        """Those of the effects that move the flange."""
        return tuple(
            effect
            for effect in self.effects
            if effect.port in _ARM_PORTS and not effect.of_session and not effect.beyond_flange
        )


def _noise_keys(noise) -> dict | None:
    """RMS distance due to noise and the source of the noise, as in the verdict of the calibration."""
    if noise.known_rms is None:
        return None
    value, source = noise.known_rms
    return {"rms_mm": value, "source": source}


def solution_keys(calibration, noise=None) -> dict:
    """Solution as `read_solution` returns it, of a `workbench.jobs.robot.calibrate.Calibration`.

    noise: its `NoiseReport` (`workbench.fitting.verdicts.noise_report`), where it is not that of the
    calibration's own samples.
    """
    noise = calibration.noise if noise is None else noise
    solution, recording = calibration.solution, calibration.recording
    parameters = solution.parameters
    return {
        "format": FORMAT,
        "recording": recording.name,
        "measures": file_kind(recording.measures),
        "robot": robot_keys(recording),
        "effects": [
            {"effect": name_of(e), "where": e.where, **e.options} for e in calibration.model.effects
        ],
        "values": dict(zip(parameters.keys, parameters.values.tolist())),
        "free": [key for key, free in zip(parameters.keys, parameters.mask) if free],
        "covariance": solution.covariance.tolist(),
        "load_centre_mm": np.asarray(calibration.model.chain.state.load_centre).tolist(),
        "held_out": calibration.held_out,
        "nominal": calibration.nominal,
        "converged": solution.converged,
        "noise_rms_mm": noise.stated_rms,
        "noise": _noise_keys(noise),
        "replicate_noise_rms_mm": noise.replicates_rms,
        "discrepancy_rms_mm": noise.discrepancy_rms,
        "warnings": [*calibration.suspicions, *noise.alarms],
        "outcome": solution.outcome,
        "undetermined": list(solution.null_sentences),
        "provenance": dict(calibration.provenance),
        "priors": {
            p.key: p.prior for p in calibration.model.parameters.table if p.prior is not None
        },
        "fitted_range": _fitted_range(calibration),
        "fitted_samples": _fitted_samples(calibration),
        "rows": int(recording.n),
        "group_names": {
            group: list(names)
            for group, names in recording.group_names.items()
            if group in MEASURED_GROUPS
        },
        "time_origin": recording.time_origin,
        "recorded_samples": _runs(recording.sample_ids),
        "configurations": _recorded_configurations(recording, calibration.model.chain.robot),
        "recorded_readings": _recorded_readings(calibration).tolist(),
        "measured_point_mm": _measured_point(calibration),
    }


def _recorded_configurations(recording, robot: Robot) -> list[list[int]] | None:
    """The configurations of the samples that are not singular, each once; None for arms without such signs."""
    if not has_configurations(robot):
        return None
    signs = configuration_signs(robot, recording.joints)
    return np.unique(signs[(signs != 0).all(1)], axis=0).tolist()


def _recorded_readings(calibration) -> np.ndarray:
    """(k, R) rad, mm: readings of at most `_MOST_READINGS` fitted poses, evenly in the order of joint 1."""
    readings = np.unique(calibration.recording.joints[_is_in_fit(calibration)], axis=0)
    return readings[:: -(-len(readings) // _MOST_READINGS) or 1]


def _measured_point(calibration) -> list[float] | None:
    """Mean of the measured points (mm) in the frame of a sensor on the flange; None for other measurements."""
    measurement = calibration.model.chain.measurement
    if measurement.place != "sensor":
        return None
    return measurement.measured[:, _is_in_fit(calibration)].mean(1).tolist()


def _is_in_fit(calibration) -> np.ndarray:
    """(n,) bool: the samples of the fit that are not far off."""
    recording = calibration.recording
    is_in_fit = ~np.isin(recording.sample_ids, calibration.suspects)
    if calibration.fitted is None:
        return is_in_fit
    return is_in_fit & calibration.fitted


def _fitted_samples(calibration) -> list[list[int]]:
    """First and last number of each run of consecutive sample numbers that the calibration was fitted to."""
    numbers = calibration.recording.sample_ids
    if calibration.fitted is not None:
        numbers = numbers[calibration.fitted]
    return _runs(np.sort(numbers))


def _runs(numbers: np.ndarray) -> list[list[int]]:
    """First and last number of each run of consecutive sample numbers, in their order."""
    numbers = np.asarray(numbers, int)
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1)
    return [[int(run[0]), int(run[-1])] for run in runs if len(run)]


def _fitted_range(calibration) -> dict[str, list[float]]:
    """Lowest and highest value of joint readings and covariates over the samples that were fitted."""
    recording = calibration.recording
    is_in_fit = _is_in_fit(calibration)
    names = [*joint_columns(recording.columns), *recording.covariates]
    found: dict[str, list[float]] = {}
    for name in names:
        values = recording.columns[name][is_in_fit]
        short_name = name.removeprefix(
            OTHER
        )  # the second end of a length is a pose of the arm like the first
        low, high = found.get(short_name, (math.inf, -math.inf))
        if values.size and short_name not in BOOKKEEPING | MEASURED:
            found[short_name] = [min(low, float(values.min())), max(high, float(values.max()))]
    return found


def robot_keys(recording) -> dict:
    """The robot of a recording, the path of a URDF made absolute so that the file may be read from anywhere.

    A recording states the path relative to the working folder, as it was read."""
    keys = dict(recording.robot)
    if "urdf" in keys:
        keys["urdf"] = str(Path(keys["urdf"]).resolve())
    return keys


def name_of(effect) -> str:
    """Name of an effect in the catalogue."""
    return next(name for name, kind in CATALOGUE.items() if kind is type(effect))


def read_solution(path: Path) -> CalibratedArm:
    """The arm of a solution.json, or of the run folder that holds one.

    Raises InputError with the file, the key and what to do.
    """
    path = Path(path)
    path = path / NAME if path.is_dir() else path
    keys = _read(path)
    try:
        effects = make_effects(
            CATALOGUE, [(row.pop("effect"), row.pop("where"), row) for row in keys["effects"]]
        )
        trusted, why = _trust(keys)
        ranges = keys.get("fitted_range")
        if ranges is not None:
            ranges = {str(name): (float(low), float(high)) for name, (low, high) in ranges.items()}
        arm = CalibratedArm(
            load_robot(keys["robot"], f"{path}, key robot"),
            effects,
            {str(key): float(value) for key, value in keys["values"].items()},
            tuple(keys["free"]),
            np.array(keys["covariance"], float).reshape(len(keys["free"]), len(keys["free"])),
            np.array(keys["load_centre_mm"], float),
            float(keys["held_out"]["rms_mm"]),
            trusted,
            why,
            keys,
            ranges,
            float(keys.get("discrepancy_rms_mm") or 0.0),
            _considered(path, keys),
            _runs_of_samples(keys.get("fitted_samples")),
            int(keys.get("rows") or 0),
            _runs_of_samples(keys.get("recorded_samples")),
            _configurations(keys.get("configurations")),
            _readings(keys.get("recorded_readings")),
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as problem:
        if isinstance(problem, InputError):
            raise
        raise InputError(
            f"{path}: expected a whole {FORMAT} file, found that {problem} is missing or not usable; "
            "calibrate again"
        ) from None
    _check_arm(path, arm)
    return arm


def _runs_of_samples(rows) -> np.ndarray | None:
    """(k, 2) of the key fitted_samples. Raises ValueError or TypeError for another shape."""
    if rows is None:
        return None
    return np.array(rows, float).reshape(len(rows), 2)


def _configurations(rows) -> np.ndarray | None:
    """(k, 3) of the key configurations. Raises ValueError or TypeError for another shape."""
    if rows is None:
        return None
    return np.array(rows, int).reshape(len(rows), 3)


def _readings(rows) -> np.ndarray | None:
    """(k, R) of the key recorded_readings, None without any. Raises ValueError or TypeError for another shape."""
    if rows:
        return np.array(rows, float).reshape(len(rows), -1)
    return None


def _considered(path: Path, keys: Mapping) -> Considered | None:
    """The terms that are not in the model. Raises InputError with the key where they are not usable."""
    try:
        return read_considered(keys.get("considered"))
    except KeyError as problem:
        raise _unusable(path, f"considered.{problem.args[0]}", "a value", "none") from None
    except (TypeError, ValueError, AttributeError, InputError) as problem:
        expected = "the models that `workbench diagnose` writes"
        found = f"a block that cannot be read ({problem})".rstrip(".")
        raise _unusable(path, "considered", expected, found) from None


def _check_arm(path: Path, arm: CalibratedArm) -> None:
    """Raise InputError where numbers of the file are missing, not finite or contradict one another."""
    if missing := sorted({*arm.free, *_geometry_keys(arm.robot)} - set(arm.values)):
        raise InputError(
            f"{path}, key values: expected a value of {missing[0]}, found none; calibrate again"
        )
    ranges = np.array([*(arm.fitted_range or {}).values()]).reshape(-1, 2)
    numbers = {
        "values": [*arm.values.values()],
        "held_out": [arm.held_out_mm],
        "covariance": arm.covariance,
        "load_centre_mm": arm.load_centre,
        "fitted_range": ranges,
        "fitted_samples": [] if arm.fitted_samples is None else arm.fitted_samples,
        "recorded_readings": [] if arm.recorded_readings is None else arm.recorded_readings,
        "measured_point_mm": arm.keys.get("measured_point_mm") or [],
        "discrepancy_rms_mm": [arm.discrepancy_mm],
    }
    for key, given in numbers.items():
        if not np.isfinite(given).all():
            raise _unusable(path, key, "finite numbers", "others")
    if arm.load_centre.shape != (3,):
        raise _unusable(path, "load_centre_mm", "three numbers", f"{arm.load_centre.size}")
    if arm.held_out_mm < 0:
        raise _unusable(path, "held_out.rms_mm", "an error of 0 or more", f"{arm.held_out_mm:g}")
    if arm.rows < 0:
        raise _unusable(path, "rows", "a number of 0 or more", f"{arm.rows}")
    if arm.discrepancy_mm < 0:
        found = f"{arm.discrepancy_mm:g}"
        raise _unusable(path, "discrepancy_rms_mm", "a distance of 0 or more", found)
    if len(set(arm.free)) != len(arm.free):
        raise _unusable(path, "free", "every parameter once", "one twice")
    if (ranges[:, 0] > ranges[:, 1]).any():
        raise _unusable(path, "fitted_range", "lowest and highest values", "them exchanged")
    if problem := _covariance_problem(arm.covariance):
        raise _unusable(path, "covariance", "a covariance matrix", problem)
    for model in () if arm.considered is None else arm.considered.models:
        if not np.isfinite(model.covariance).all():
            raise _unusable(path, "considered.models.covariance", "finite numbers", "others")
        if problem := _covariance_problem(model.covariance):
            raise _unusable(path, "considered.models.covariance", "a covariance matrix", problem)


def _covariance_problem(covariance: np.ndarray) -> str:
    """Why a matrix (F, F) is no covariance matrix, "" where it is one.

    It is symmetric and positive semi-definite. Rounding is judged after the scaling to correlations,
    because variances in mm^2 and rad^2 differ by many powers of ten.
    """
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if (np.diag(covariance) < 0).any():
        return "a negative variance"
    scale = np.where(sigma > 0, sigma, 1.0)
    correlation = covariance / scale[:, None] / scale[None, :]
    if np.abs(correlation - correlation.T).max(initial=0.0) > 1e-6:
        return "a matrix that is not symmetric"
    lowest = np.linalg.eigvalsh(correlation)[0] if len(correlation) else 0.0
    if lowest < -1e-6 * len(correlation):
        return "a matrix with a negative eigenvalue"
    return ""


def _unusable(path: Path, key: str, expected: str, found: str) -> InputError:
    return InputError(f"{path}, key {key}: expected {expected}, found {found}; calibrate again")


def without_terms(arm: CalibratedArm, patterns: Sequence[str], where: str) -> CalibratedArm:
    """The arm with some of its effects switched off; the values of the others stay as they were calibrated.

    patterns: `<place>.<effect>`, as `joint-3.backlash`, with shell wildcards. where: what to call the calibration in
    an error sentence. Raises InputError for a pattern that no effect matches.
    """
    if not patterns:
        return arm
    names = [term_names(effect.effect, effect.where, name_of(effect)) for effect in arm.effects]
    disabled = switched_off(names, patterns, where)
    return replace(arm, effects=tuple(e for e, is_off in zip(arm.effects, disabled) if not is_off))


def _geometry_keys(robot: Robot) -> list[str]:
    names = ("theta", "d", "a", "alpha", "beta")
    return [f"joint-{k}.{name}{k}" for k in range(1, robot.joints + 1) for name in names]


def _read(path: Path) -> dict:
    try:
        keys = read_json(path)
    except OSError as problem:
        raise InputError(
            f"{path}: expected a solution.json or the run folder of `workbench calibrate`, found that it "
            f"cannot be read ({problem.strerror}); name another"
        ) from None
    except ContentError as problem:
        raise InputError(
            f"{path}: expected JSON as `workbench calibrate` writes it, found another kind of file "
            f"({problem}); name its solution.json"
        ) from None
    _check_format(keys, path)
    return keys


def _check_format(keys, path: Path) -> None:
    if not isinstance(keys, dict) or keys.get("format") != FORMAT:
        raise InputError(
            f"{path}, key format: expected '{FORMAT}', found something else; "
            "name the solution.json of a run of `workbench calibrate`"
        )


def _trust(keys) -> tuple[bool, str]:
    """Whether a calibration may be used without being forced, and the sentence if not."""
    held_out = keys["held_out"]["rms_mm"]
    nominal = keys["nominal"]["rms_mm"]
    if not keys["converged"]:
        return False, f"the solve {keys['outcome']}"
    if held_out is None:
        return False, "it has no held-out error"
    if _is_no_better(keys):
        return (
            False,
            f"its held-out error ({held_out:.4g} mm) is not below that of the nominal arm ({nominal:.4g} mm)",
        )
    if keys.get(
        "warnings"
    ):  # base and tool alone were so far off that something else than the arm is wrong
        return False, f"its recording is in doubt ({keys['warnings'][0]})"
    return True, ""


def _is_no_better(keys) -> bool:
    """Whether more than frames was estimated, with a held-out error that is not below that of the nominal arm."""
    is_nominal = not keys["effects"] and all(key.startswith(_FRAMES) for key in keys["free"])
    held_out = keys["held_out"]["rms_mm"]
    return not is_nominal and held_out is not None and not held_out < keys["nominal"]["rms_mm"]
