"""Which calibrations and which corrected targets may be sent to an arm.

A wrong correction moves a real robot into its fixture. Two questions are answered. May this calibration be used at all:
its held-out errors and its parameters must be plausible. May this target be corrected: the correction, its standard
uncertainty, its load, its temperature and its joint readings must stay within what the calibration covers.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from datasets.errors import complaint
from robot_model.effects.extrapolation import CLOCK
from robot_model.state import approaches_read, reading_names, sliding
from robot_model.system import geometry_priors
from workbench.core.errors import InputError
from workbench.core.text.row_numbers import listed_numbers
from workbench.core.vocabulary import Covariate
from workbench.files.solution_file import LARGEST_DEG, LARGEST_MM, CalibratedArm
from workbench.jobs.robot.compensation.compensate import (
    actual_poses,
    considered_covariates,
    covariates_read,
    half_loops_mm,
)
from workbench.jobs.robot.compensation.confirmed_correction import largest_corrections
from workbench.jobs.robot.compensation.moved_tool import moved_tool_words
from workbench.jobs.robot.compensation.revolutions import recorded_middle
from workbench.jobs.robot.compensation.singularity import reading_words, singular_joint
from workbench.jobs.robot.compensation.unattainable import left_by_joints
from workbench.jobs.robot.compensation.unrecorded_load import (
    LOAD,
    deflection_mm,
    is_load_unrecorded,
    only_stated_load,
    unknown_load_words,
)

_CORRECT_THE_INPUT = "correct the recording or the robot file and calibrate again, or add --force"
_NOMINAL_SUFFICES = (
    "the nominal arm is the better model: use its robot file as it is, or estimate base and tool alone with "
    "`workbench calibrate RECORDING --plan base-and-tool`; --force uses this calibration all the same"
)
# No arm deviates from its model by a hundred times the noise of an instrument that is fit to measure it: noise then
# makes less than a ten-thousandth of the mean square. The noise statement, the data or the model is wrong.
_FAR_ABOVE_NOISE = 100.0
# Five prior standard deviations (three typical sizes each): 6e-7 by chance for one parameter, 3e-5 for fifty.
_FAR_FROM_NOMINAL, _FAR_PROBABILITY = 5.0, 5.7e-7
# The data determine a parameter where they cut its prior variance to a quarter; the rest is prior or gauge.
_DETERMINED = 0.5
# The error to expect is then sqrt(1 + 3^2) = 3.2 times what the calibration states for the targets it was tested on.
_SIGMA_FACTOR = 3.0
# Outside the recorded range, in extents of that range: accepted without a word, and with a warning.
_ACCEPTED_EXTENTS, _MAX_EXTENTS = 0.1, 1.0
# Extent of a joint that hardly moved in the recording: the correction itself moves it by part of a degree.
_LEAST_TURN, _LEAST_SLIDE = np.deg2rad(10.0), 100.0
LARGEST_JOINT_DEG = 10.0
"""Change of a joint angle by a correction of at most one degree: ten times as much is a nearly singular posture."""
# postures (rad about the middle of the recorded readings) at which a load must move the flange, and by how much
_POSTURES, _LEAST_MM = 9, 1e-3
_NAMED_TARGETS = 6
_FLANGE_LOAD = "the load on the flange"
_NO_RANGES = (
    "The solution states no ranges of load, temperature and joints, since an older version wrote it; targets are not "
    "compared with them. Calibrate again."
)


@dataclass(frozen=True)
class Limits:
    """Largest plausible corrections.

    `correction_mm`, `correction_deg`: of the position and the orientation of the flange; None: 10 mm and 1 deg, and
    more where the measurements confirm it (`largest_corrections`). `sigma_mm`: largest standard
    uncertainty of a corrected position; None: three times the held-out error, and never above the error of the nominal
    arm, since a correction that is less certain than the error it removes does no good. `joint_deg`: change of a
    programmed joint angle; next to a singular posture a small correction of the flange is a large one of joints.
    """

    correction_mm: float | None = None
    correction_deg: float | None = None
    sigma_mm: float | None = None
    joint_deg: float = LARGEST_JOINT_DEG

    def __post_init__(self):
        for option, value in (
            ("--max-correction-mm", self.correction_mm),
            ("--max-correction-deg", self.correction_deg),
            ("--max-sigma-mm", self.sigma_mm),
            ("--max-joint-change-deg", self.joint_deg),
        ):
            if value is not None and not value > 0:
                raise InputError(
                    f"{option} {value:g}: expected a number above 0, found another; correct it"
                )

    def largest_correction(self, arm: CalibratedArm) -> tuple[float, float]:
        """Position (mm) and orientation (deg) of the flange beyond which a correction of this arm is refused."""
        stated = self.correction_mm, self.correction_deg
        if None not in stated:
            return stated
        confirmed = largest_corrections(arm)
        return tuple(limit if given is None else given for given, limit in zip(stated, confirmed))

    def largest_sigma_mm(self, arm: CalibratedArm) -> float:
        """Standard uncertainty, mm, above which a target of this arm is refused."""
        if self.sigma_mm is not None:
            return self.sigma_mm
        nominal = arm.keys.get("nominal", {}).get("rms_mm") or math.inf
        # A held-out error below the noise that was stated is luck, or exact data.
        expected = max(arm.held_out_mm, arm.keys.get("noise_rms_mm") or 0.0)
        return min(_SIGMA_FACTOR * expected, nominal)


@dataclass(frozen=True)
class Judgement:
    """`refused`: target index -> reasons; `warnings`: sentences about targets that are used all the same."""

    refused: Mapping[int, list[str]]
    warnings: list[str]


def checked(arm: CalibratedArm, path, force: bool, limits: Limits | None = None) -> CalibratedArm:
    """The arm, where its calibration may be used; InputError where it may not and nobody forces it."""
    why = doubt_about(arm, limits or Limits())
    if force or not why:
        return arm
    is_only_no_better = arm.is_no_better_than_nominal and arm.keys["converged"]
    remedy = _NOMINAL_SUFFICES if is_only_no_better else _CORRECT_THE_INPUT
    raise InputError(
        f"{path}: expected a calibration that converged and is plausible on unseen samples, found that {why}; {remedy}"
    )


def doubt_about(arm: CalibratedArm, limits: Limits) -> str:
    """Why this calibration should move no arm, as part of a sentence; "" where nothing speaks against it."""
    if not arm.trusted:
        return arm.why
    return _implausible_error(arm, limits) or _implausible_parameters(arm)


def _implausible_error(arm: CalibratedArm, limits: Limits) -> str:
    """A held-out error that no use of the corrections can tolerate."""
    largest_mm = limits.correction_mm or LARGEST_MM
    largest_deg = limits.correction_deg or LARGEST_DEG
    if arm.held_out_mm > largest_mm:
        return (
            f"its held-out RMS position error of {arm.held_out_mm:.3g} mm is above the largest correction of "
            f"{largest_mm:g} mm"
        )
    rotation = arm.keys.get("held_out", {}).get("rotation_rms_deg")
    if rotation is not None and rotation > largest_deg:
        return (
            f"its held-out RMS orientation error of {rotation:.3g} deg is above the largest correction of "
            f"{largest_deg:g} deg"
        )
    noise = arm.keys.get("noise_rms_mm")
    if noise and arm.held_out_mm > _FAR_ABOVE_NOISE * noise:
        return (
            f"its held-out RMS position error of {arm.held_out_mm:.3g} mm is {arm.held_out_mm / noise:.0f} times the "
            f"stated noise of {noise:.3g} mm"
        )
    return ""


def parameter_deviations(arm: CalibratedArm) -> dict[str, float]:
    """Deviations from nominal, in prior standard deviations, of the parameters of the arm that the data determine.

    Base, tool and instrument have no nominal value. A parameter in an undetermined direction keeps most of its prior
    variance and is left out: its value is the prior's, or a matter of gauge.
    """
    geometry = geometry_priors(arm.robot)
    acting = tuple(f"{effect.where}.{effect.effect}." for effect in arm.acting_effects)
    recorded = arm.keys.get("priors", {})
    found = {}
    for key, variance in zip(arm.free, np.diag(arm.covariance)):
        if key in geometry:
            nominal, prior = geometry[key]
        elif key.startswith(acting) and recorded.get(key):
            nominal = 0.0
            prior = float(recorded[key])
        else:
            continue
        if variance < (_DETERMINED * prior) ** 2:
            found[key] = (arm.values[key] - nominal) / prior
    return found


def _implausible_parameters(arm: CalibratedArm) -> str:
    """Parameters too far from nominal: each by itself, and all together (chi-square of the prior)."""
    from workbench.core.distributions import chi2

    deviations = parameter_deviations(arm)
    if not deviations:
        return ""
    key = max(deviations, key=lambda name: abs(deviations[name]))
    largest = abs(deviations[key])
    sum_of_squares = sum(value**2 for value in deviations.values())
    is_one_far = largest > _FAR_FROM_NOMINAL
    if not is_one_far and chi2.sf(sum_of_squares, len(deviations)) > _FAR_PROBABILITY:
        return ""
    sentence = f"parameter {key} is {_amount(arm, key)} from nominal, {largest:.1f} prior standard deviations"
    if is_one_far:
        return sentence
    rms = math.sqrt(sum_of_squares / len(deviations))
    return f"{sentence}, and all {len(deviations)} determined parameters are {rms:.1f} from nominal on average (RMS)"


def _amount(arm: CalibratedArm, key: str) -> str:
    """The deviation of a parameter in the unit that people read."""
    nominal = geometry_priors(arm.robot).get(key, (0.0, 0.0))[0]
    name = key.rpartition(".")[2].rstrip("0123456789")
    deviation = arm.values[key] - nominal
    if name in ("theta", "alpha", "beta"):
        return f"{np.rad2deg(deviation):.3g} deg"
    if name in ("a", "d"):
        return f"{deviation:.3g} mm"
    return f"{deviation:.3g}"


_LOAD_OPTION = {LOAD: ", or state one load for all targets with --payload-kg"}


def covariates_of(arm: CalibratedArm, programme) -> Mapping[str, np.ndarray]:
    """The columns of a programme that the model may read: those that the recording of the calibration had.

    A model that was fitted with a temperature takes hours where it finds none, and the reverse; so a column that it
    reads must be there; a target has no history, so that sides of approach may be left out. A load that only the
    targets state, the same for all, is that of the recording. Raises InputError where a column is missing.
    """
    if arm.fitted_range is None:
        return programme.covariates
    sides = set(approaches_read(arm.acting_effects))
    needed = covariates_read(arm) | ({LOAD} if _reads_load(arm) else set())
    for name in sorted(needed - set(programme.covariates) - sides):
        low, high = arm.fitted_range[name]
        raise complaint(
            f"{programme.table.called}, column {name}",
            f"this column, on which the calibrated correction depends ({low:.4g} to {high:.4g} in the recording)",
            "no such column",
            "add it with the values that hold when the programme runs" + _LOAD_OPTION.get(name, ""),
        )
    known = {*arm.fitted_range, *sides, LOAD}
    if only_stated_load(arm, programme):
        known.remove(LOAD)
    return {name: values for name, values in programme.covariates.items() if name in known}


def _reads_load(arm: CalibratedArm) -> bool:
    """Whether the recorded load moves the flange: without the column a target would count as unloaded."""
    load = max(arm.fitted_range.get(LOAD, (0.0, 0.0)))
    if not load or not any(effect.elastic for effect in arm.acting_effects):
        return False
    middle = {name: sum(ends) / 2 for name, ends in arm.fitted_range.items()}
    readings = recorded_middle(arm) + np.linspace(-0.5, 0.5, _POSTURES)[:, None]
    loaded, unloaded = (
        actual_poses(arm, readings, middle | {LOAD: mass})[:, :3, 3] for mass in (load, 0.0)
    )
    return bool(np.abs(loaded - unloaded).max() > _LEAST_MM)


def judge_targets(arm: CalibratedArm, programme, found, limits: Limits) -> Judgement:
    """Targets of a `Programme` that must not be sent to the arm, and warnings; found: its `Compensated`."""
    shift = deflection_mm(arm, programme, found, covariates_of(arm, programme))
    reasons = [
        *_above_limits(arm, found, limits, _judged_sigma(arm, programme, found, limits, shift)),
        *_joint_changes(arm, programme, found, limits.joint_deg),
    ]
    warnings = [
        *left_by_joints(arm, found),
        *_worst_assumed(arm, programme),
        *_unknown_sides(arm, programme, found),
        *unknown_load_words(arm, programme, shift),
        *moved_tool_words(arm),
    ]
    for covered in _coverages(arm, programme, found, bool(shift.any())):
        is_refused = found.reached & (covered.excess > _MAX_EXTENTS) & covered.is_read
        reasons += [(row, covered.reason(row)) for row in np.flatnonzero(is_refused)]
        is_outside = found.reached & (covered.excess > _ACCEPTED_EXTENTS)
        warnings += covered.warning(is_outside & ~is_refused)
    if arm.fitted_range is None:
        warnings.append(_NO_RANGES)
    refused: dict[int, list[str]] = {}
    for row, reason in reasons:
        refused.setdefault(int(row), []).append(reason)
    return Judgement(refused, warnings)


def _judged_sigma(arm: CalibratedArm, programme, found, limits: Limits, shift) -> np.ndarray:
    """(n,) mm, standard uncertainty that is compared with its limit.

    Without a limit of the user: without another load and the other side of a loop, of which warnings speak. No single
    target is at fault, and the uncorrected arm has the same loop.
    """
    if limits.sigma_mm is not None:
        return found.sigma_mm
    loops = _loops(arm, programme, found)
    return np.sqrt(np.maximum(found.sigma_mm**2 - shift**2 - loops**2, 0.0))


def _above_limits(
    arm: CalibratedArm, found, limits: Limits, sigma: np.ndarray
) -> Iterator[tuple[int, str]]:
    """Row and reason of corrections, uncertainties (n,) mm and unattainable remainders above their limits."""
    largest_mm, largest_deg = limits.largest_correction(arm)
    joints = arm.robot.mixing.shape[1]
    remain = f"is not attainable with {joints} joints: {{}} remain, above {{}}"
    for reason, values, largest, unit in (
        ("its correction of {} exceeds {}", found.position_mm, largest_mm, "mm"),
        ("its correction of {} exceeds {}", found.rotation_deg, largest_deg, "deg"),
        ("the standard uncertainty of {} exceeds {}", sigma, limits.largest_sigma_mm(arm), "mm"),
        (f"its position {remain}", found.position_left_mm, largest_mm, "mm"),
        (f"its orientation {remain}", found.rotation_left_deg, largest_deg, "deg"),
    ):
        for row in np.flatnonzero(found.reached & ~(values <= largest)):
            yield row, reason.format(f"{values[row]:.3g} {unit}", f"{largest:.3g} {unit}")


def _joint_changes(arm: CalibratedArm, programme, found, largest: float) -> list[tuple[int, str]]:
    """Target and reason where a programmed joint angle would change by more than `largest`, deg."""
    is_joint = programme.is_joint
    if programme.poses is not None and is_joint is None:
        return []
    rotates = ~sliding(arm.robot)
    changes = np.rad2deg(np.abs(found.readings - programme.readings)) * rotates
    if is_joint is not None:
        changes = changes * is_joint[:, None]
    reasons = []
    for row in np.flatnonzero(found.reached & (changes.max(1) > largest)):
        joint = int(changes[row].argmax())
        reasons.append(
            (
                int(row),
                f"its correction changes joint {joint + 1} by {changes[row, joint]:.3g} deg, above {largest:.3g} deg"
                f"{_singular(arm.robot, programme.readings[row])}",
            )
        )
    return reasons


def _singular(robot, reading) -> str:
    """That the posture is singular, the joint at its singular position, and what to do; "" where it is not."""
    joint = singular_joint(robot, reading)
    if joint is None:
        return ""
    value = reading_words(robot, reading, joint)
    return (
        f": the posture is nearly singular, with joint {joint} at {value}; "
        f"move joint {joint} some degrees away from this position"
    )


def _worst_assumed(arm: CalibratedArm, programme) -> list[str]:
    """A sentence on columns that are missing and that only the uncertainty depends on, or none."""
    missing = sorted(considered_covariates(arm) - set(programme.covariates))
    if not missing:
        return []
    ranges = ", ".join(f"{name} ({_ends(arm.fitted_range[name])})" for name in missing)
    return [
        f"The targets have no column {ranges}. An effect that the diagnosis found and did not retain depends "
        "on it; sigma_mm takes the worst end of the recorded range. Add the column with the values that hold when the "
        "programme runs."
    ]


def _loops(arm: CalibratedArm, programme, found) -> np.ndarray:
    """(n,) mm: half the width of loops whose side the targets do not state; 0 where a target is not reached."""
    loops = np.zeros(len(found.reached))
    if found.reached.any():
        columns = {name: values[found.reached] for name, values in programme.covariates.items()}
        loops[found.reached] = half_loops_mm(arm, found.readings[found.reached], columns)
    return loops


def _unknown_sides(arm: CalibratedArm, programme, found) -> list[str]:
    """A sentence on loops of hysteresis or backlash whose side the targets do not state, or none."""
    missing = sorted(set(approaches_read(arm.acting_effects)) - set(programme.covariates))
    if not missing or not found.reached.any():
        return []
    half = _loops(arm, programme, found).max()
    terms = [effect.title for effect in arm.acting_effects if approaches_read([effect])]
    return [
        f"The targets do not state the side that joints come from: {', '.join(terms)} counts with the centre of its "
        f"loop, and sigma_mm contains half the width of the loop, up to {half:.2g} mm. Add the column "
        f"{', '.join(missing)} (-1 or 1, the sign of the last long move) to correct it as well."
    ]


def _ends(limits) -> str:
    return f"{limits[0]:.4g} to {limits[1]:.4g}"


@dataclass(frozen=True)
class _Coverage:
    """One column of the targets against the range that was recorded: `values` (n,), `low` and `high` in `unit`.

    `excess` (n,): distance from the range in units of its extent; `is_read`: the correction depends on the column.
    """

    name: str
    values: np.ndarray
    low: float
    high: float
    unit: str
    excess: np.ndarray
    is_read: bool
    is_recorded: bool = True

    def reason(self, k: int) -> str:
        if not self.is_recorded:
            return (
                f"{self.name} of {self.values[k]:.4g} {self.unit} deflects the arm, and the recording states no load; "
                f"add the column {LOAD} to the recording and calibrate again"
            )
        return f"{self.name} of {self.values[k]:.4g} {self.unit} is far outside {self._range()}, which was recorded"

    def warning(self, rows: np.ndarray) -> list[str]:
        """A sentence on the targets outside the recorded range, or none."""
        if not rows.any():
            return []
        targets = listed_numbers(np.flatnonzero(rows), _NAMED_TARGETS)
        return [
            f"{self.name} is outside {self._range()}, which was recorded, in target "
            f"{targets}: {self._meaning()}; record samples there or check these targets."
        ]

    def _meaning(self) -> str:
        """What a correction outside the recorded range is."""
        if self.is_read:
            meaning = "the correction extrapolates"
        else:
            meaning = "the model does not depend on it, the arm may"
        if self.name == _FLANGE_LOAD:
            meaning += "; uncertainty_mm contains no deflection that the recording does not show"
        return meaning

    def _range(self) -> str:
        return f"{self.low:.4g} to {self.high:.4g} {self.unit}".strip()


def _coverages(arm: CalibratedArm, programme, found, is_load_uncertain: bool) -> list[_Coverage]:
    """is_load_uncertain: the uncertainty contains what the load of the targets may deflect."""
    if arm.fitted_range is None:
        return []
    return [
        *([] if is_load_uncertain else [_load(arm, programme, len(found.reached))]),
        *_other_covariates(arm, programme),
        *_joints(arm, found),
    ]


def _load(arm, programme, n) -> _Coverage:
    """The whole load on the flange: that of the empty tool is part of what bends the arm."""
    tool = arm.robot.payload_mass
    low, high = (tool + value for value in arm.fitted_range.get(LOAD, (0.0, 0.0)))
    values = tool + programme.covariates.get(LOAD, np.zeros(n))
    is_read = any(effect.elastic for effect in arm.acting_effects)
    excess = _excess(values, low, high, max(high - low, high))
    is_recorded = not is_load_unrecorded(arm)
    return _Coverage(_FLANGE_LOAD, values, low, high, "kg", excess, is_read, is_recorded)


def _other_covariates(arm, programme):
    read = covariates_read(arm)
    for name, (low, high) in arm.fitted_range.items():
        values = programme.covariates.get(name)
        is_temperature = Covariate.of(name).kind == "temperature"
        if name in (LOAD, CLOCK) or values is None or not (name in read or is_temperature):
            continue  # the uncertainty grows with the time after the recording
        excess = _excess(values, low, high, high - low)
        yield _Coverage(name, values, low, high, "", excess, name in read)


def _joints(arm, found):
    for name, readings in zip(reading_names(arm.robot), found.readings.T):
        if name in arm.fitted_range:
            yield _joint_coverage(name, readings, *arm.fitted_range[name])


def _joint_coverage(name: str, readings: np.ndarray, low: float, high: float) -> _Coverage:
    """readings: (n,) rad, mm; low, high: of the recording, deg, mm, as the name says."""
    unit = name.rpartition("_")[2]
    values = readings if unit == "mm" else np.rad2deg(readings)
    min_extent = _LEAST_SLIDE if unit == "mm" else np.rad2deg(_LEAST_TURN)
    excess = _excess(values, low, high, max(high - low, min_extent))
    return _Coverage(name, values, low, high, unit, excess, True)


def _excess(values, low, high, extent) -> np.ndarray:
    """(n,) distance from [low, high] in extents; 0 within, inf outside a range that has none, nan for nan."""
    distance = np.maximum(np.maximum(low - values, values - high), 0.0)
    rounding = 1e-9 * max(abs(low), abs(high))
    distance = np.where(distance <= rounding, 0.0, distance)
    if extent > 0:
        return distance / extent
    return np.where(distance > 0, np.inf, 0.0)
