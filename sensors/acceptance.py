"""An acceptance report as data: form, size, spacing and flatness errors, each defined, and determined or not.

Characteristics carry the symbols of ISO 10360-13:2021 (SV: a single view, O3D: optical 3D system) and the
older ones of VDI/VDE 2634 part 2:2012. What is computed is each characteristic's evaluation; an acceptance
test asks in addition for the standard's artefacts and positions in the volume. Nothing passes without a
limit that the user gave.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sensors.ball.extent import shell
from sensors.ball.fit import fit_ball
from sensors.ball.result import (
    EDGE,
    INCIDENCE,
    MISSING,
    NOT_ON_BALL,
    OUTLIER,
    REASONS,
    USED,
    BallFit,
)
from workbench.core.errors import InputError
from workbench.core.least_squares.linear_algebra import symmetric_eigen

NOT_JUDGED = "not judged: no limit was given"
WITHIN_LIMIT = "within the limit"
BEYOND_LIMIT = "beyond the limit"
UNDECIDED = "undecided: the limit lies within the value's uncertainty (k = 2)"
UNKNOWN = "not judged: the value could not be determined"
# Part of the points that VDI/VDE 2634 allows to leave out, and part that the shell of ISO 10360 holds.
_LEFT_OUT, _CONTAINED_SHARE, _MIN_POINTS = 0.003, 0.95, 20
_REFERENCE_C = 20.0


@dataclass(frozen=True)
class Characteristic:
    """One line of the report.

    `symbol` of ISO 10360-13 and `vdi` of VDI/VDE 2634-2, empty where they have none; `value` in `unit`,
    nan where it could not be determined, and then `why`; `n` values it was made of; `std` its standard
    uncertainty, None where unknown; `parts` the single results, by name; `limit` as the user gave it, and
    the `verdict`.
    """

    name: str
    symbol: str
    vdi: str
    definition: str
    value: float
    unit: str
    n: int
    std: float | None = None
    why: str = ""
    parts: Mapping[str, float] = field(default_factory=dict)
    limit: float | None = None
    verdict: str = NOT_JUDGED

    @property
    def determined(self) -> bool:
        """Whether there is a value."""
        return bool(np.isfinite(self.value))


@dataclass(frozen=True)
class Probed:
    """A ball that was scanned: points (3, n) mm, the fit, and its calibrated radius (mm, with standard uncertainty)."""

    number: int
    points: np.ndarray
    fit: BallFit
    radius: float | None = None
    radius_std: float = 0.0

    @cached_property
    def unconstrained(self) -> BallFit:
        """The least-squares ball of free radius through all points that were not trimmed."""
        counted = (self.fit.reason == USED) | (self.fit.reason == OUTLIER)
        return fit_ball(
            self.points[:, counted],
            loss="linear",
            start=np.append(self.fit.centre, self.fit.radius),
        )


def acceptance(
    balls: Sequence[Probed] = (),
    artefact: np.ndarray | None = None,
    plane: np.ndarray | None = None,
    temperature=None,
    limits: Mapping[str, float] | None = None,
    artefact_std: float = 0.0,
) -> tuple[Characteristic, ...]:
    """Every characteristic, determined or not.

    `artefact` (3, m) mm calibrated centres, column K - 1 of ball K, with standard uncertainty `artefact_std` of a
    distance; `plane` (3, n) mm points on a flat; `temperature` (k,) deg C; `limits` by name of the
    characteristic, in its unit. InputError where a limit names none of them.
    """
    numbers = np.array([ball.number for ball in balls], int)
    fits = [ball.fit for ball in balls]
    characteristics = [
        probing_form(balls),
        probing_range(balls),
        probing_rms(balls),
        probing_size(balls),
        sphere_spacing(fits, numbers, artefact, artefact_std),
        flat_form(plane),
        flat_range(plane),
        rejected(fits),
        mean_temperature(temperature),
    ]
    unknown = set(limits or {}) - {characteristic.name for characteristic in characteristics}
    if unknown:
        known = ", ".join(characteristic.name for characteristic in characteristics)
        raise InputError(
            f"limits: expected names among {known}, found '{sorted(unknown)[0]}'; correct its name"
        )
    return tuple(
        with_verdict(characteristic, (limits or {}).get(characteristic.name))
        for characteristic in characteristics
    )


def with_verdict(characteristic: Characteristic, limit: float | None) -> Characteristic:
    """With the verdict that a limit allows: ISO 14253-1, uncertainty at k = 2 where it is known."""
    if limit is None:
        return replace(characteristic, limit=None, verdict=NOT_JUDGED)
    if not characteristic.determined:
        return replace(characteristic, limit=limit, verdict=UNKNOWN)
    size = abs(characteristic.value)
    expanded_uncertainty = 2 * (characteristic.std or 0.0)
    verdict = (
        WITHIN_LIMIT
        if size + expanded_uncertainty <= limit
        else BEYOND_LIMIT
        if size - expanded_uncertainty > limit
        else UNDECIDED
    )
    return replace(characteristic, limit=float(limit), verdict=verdict)


def probing_form(balls: Sequence[Probed]) -> Characteristic:
    """Probing form dispersion error: width of the thinnest shell that holds 95 % of all points of a ball.

    The shell is concentric with the unconstrained least-squares ball through all points that the
    stated trimming by incidence and edge left; outliers count. Of several balls the largest.
    """
    return _of_balls(
        probing_form,
        "probing_form",
        "P_Form.Sph.D95%:SMV.SV:O3D",
        "",
        balls,
        lambda ball: shell(ball.unconstrained.residual, _CONTAINED_SHARE),
    )


def probing_range(balls: Sequence[Probed]) -> Characteristic:
    """Probing error, form: range of the distances of the points of a ball from its least-squares ball of free radius.

    At most 3 of 1,000 points are left out, those that widen the range most. Of several balls the largest.
    """
    return _of_balls(
        probing_range,
        "probing_range",
        "",
        "PF",
        balls,
        lambda ball: shell(ball.unconstrained.residual, 1 - _LEFT_OUT),
    )


def probing_rms(balls: Sequence[Probed]) -> Characteristic:
    """Root mean square of the distances of the points used from the fitted ball, over their degrees of freedom.

    Not in the standards; the figure that papers quote. Outliers do not count. Of several balls the largest.
    """
    return _of_balls(probing_rms, "probing_rms", "", "", balls, lambda ball: ball.fit.rms)


def probing_size(balls: Sequence[Probed]) -> Characteristic:
    """Probing size error: measured less calibrated diameter of a ball, from all its points.

    The diameter is that of the unconstrained least-squares ball. Of several balls the largest in size,
    with its sign. Standard uncertainty: of the fit and of the calibration.
    """
    known = [ball for ball in balls if ball.radius is not None]
    characteristic = _of_balls(
        probing_size,
        "probing_size",
        "P_Size.Sph.All:SMV.SV:O3D",
        "PS",
        known,
        lambda ball: 2 * (ball.unconstrained.radius - ball.radius),
    )
    if not known and balls:
        return replace(characteristic, why="no calibrated radius was given")
    if not characteristic.determined:
        return characteristic
    worst = next(ball for ball in known if f"ball-{ball.number}" == _worst(characteristic.parts))
    return replace(
        characteristic, std=2 * float(np.hypot(worst.unconstrained.std[-1], worst.radius_std))
    )


def sphere_spacing(
    fits: Sequence[BallFit],
    numbers: np.ndarray,
    artefact: np.ndarray | None,
    artefact_std: float = 0.0,
) -> Characteristic:
    """Sphere-spacing error: measured less calibrated distance between the centres of two balls.

    Of all pairs the largest in size, with its sign. Standard uncertainty: of both centres along the line
    between them, and of the calibration.
    """
    pairs = [(a, b) for a in range(len(fits)) for b in range(a) if fits[a] and fits[b]]
    names = "sphere_spacing", "D_CC:SMV.SV:O3D", "SD"
    if artefact is None or not pairs:
        why = (
            "no calibrated centres were given"
            if artefact is None
            else "fewer than two balls were measured"
        )
        return _undetermined(sphere_spacing, *names, "mm", why)
    unknown_balls = set(numbers.tolist()) - set(range(1, artefact.shape[1] + 1))
    if unknown_balls:
        raise InputError(
            f"ball {min(unknown_balls)}: expected one of the {artefact.shape[1]} balls of the artefact, "
            "found none of that number; correct it"
        )
    by_pair = {}
    sigma_of_sums = {}
    for a, b in pairs:
        line = fits[a].centre - fits[b].centre
        length = np.linalg.norm(line)
        name = f"ball-{min(numbers[[a, b]])} to ball-{max(numbers[[a, b]])}"
        known = np.linalg.norm(artefact[:, numbers[a] - 1] - artefact[:, numbers[b] - 1])
        covariance_sum = fits[a].covariance[:3, :3] + fits[b].covariance[:3, :3]
        by_pair[name] = float(length - known)
        sigma_of_sums[name] = float(
            np.sqrt(line @ covariance_sum @ line / length**2 + artefact_std**2)
        )
    worst = _worst(by_pair)
    return _characteristic(
        sphere_spacing,
        *names,
        by_pair[worst],
        "mm",
        len(by_pair),
        std=sigma_of_sums[worst],
        parts=by_pair,
    )


def flat_form(plane: np.ndarray | None) -> Characteristic:
    """Flat form distortion error: distance of the two nearest planes, parallel to the least-squares plane, that hold
    95 % of all points measured on a flat."""
    return _of_plane(
        flat_form, "flat_form", "D_Form.Pla.D95%:SMV.SV:O3D", "", plane, _CONTAINED_SHARE
    )


def flat_range(plane: np.ndarray | None) -> Characteristic:
    """Flatness measurement error: range of the signed distances of points on a flat from their least-squares plane.

    At most 3 of 1,000 points are left out, those that widen the range most.
    """
    return _of_plane(flat_range, "flat_range", "", "F", plane, 1 - _LEFT_OUT)


def rejected(fits: Sequence[BallFit]) -> Characteristic:
    """Share of the points on balls that were not used, for whatever reason; by reason under `parts`.

    Points that no surface returned and those of other surfaces do not count.
    """
    reasons = np.concatenate([fit.reason for fit in fits]) if fits else np.zeros(0, int)
    reasons = reasons[(reasons != MISSING) & (reasons != NOT_ON_BALL)]
    if not len(reasons):
        return _undetermined(rejected, "rejected", "", "", "1", "no ball was measured")
    by_reason = {
        REASONS[code]: float((reasons == code).mean()) for code in (EDGE, INCIDENCE, OUTLIER)
    }
    share = float((reasons != USED).mean())
    return _characteristic(rejected, "rejected", "", "", share, "1", len(reasons), parts=by_reason)


def mean_temperature(temperature) -> Characteristic:
    """Mean temperature while measuring; under `parts` its range and its distance from the reference, 20 deg C.

    Lengths are stated as measured: none of them is corrected to the reference temperature (ISO 1).
    """
    values = np.atleast_1d(np.asarray([] if temperature is None else temperature, float))
    values = values[np.isfinite(values)]
    if not len(values):
        return _undetermined(
            mean_temperature, "temperature", "", "", "deg C", "no temperature was recorded"
        )
    mean = float(values.mean())
    by_statistic = {"range": float(np.ptp(values)), "from 20 deg C": mean - _REFERENCE_C}
    return _characteristic(
        mean_temperature, "temperature", "", "", mean, "deg C", len(values), parts=by_statistic
    )


def _of_balls(of: Callable, name, symbol, vdi, balls, measure) -> Characteristic:
    """The largest over the balls of what `measure` says, mm."""
    usable_balls = [ball for ball in balls if ball.fit and ball.fit.inliers.sum() >= _MIN_POINTS]
    by_ball = {f"ball-{ball.number}": float(measure(ball)) for ball in usable_balls}
    by_ball = {name: value for name, value in by_ball.items() if np.isfinite(value)}
    if not by_ball:
        why = (
            "no ball was measured"
            if not balls
            else f"no ball with {_MIN_POINTS} points or more was fitted"
        )
        return _undetermined(of, name, symbol, vdi, "mm", why)
    n = sum(int((ball.fit.reason <= OUTLIER).sum()) for ball in usable_balls)
    return _characteristic(of, name, symbol, vdi, by_ball[_worst(by_ball)], "mm", n, parts=by_ball)


def _of_plane(of, name, symbol, vdi, plane, share) -> Characteristic:
    points = np.zeros((3, 0)) if plane is None else plane[:, np.isfinite(plane).all(0)]
    if points.shape[1] < _MIN_POINTS:
        why = (
            "no plane was measured"
            if plane is None
            else f"fewer than {_MIN_POINTS} points on the plane"
        )
        return _undetermined(of, name, symbol, vdi, "mm", why)
    from_middle = points - points.mean(1, keepdims=True)
    normal = symmetric_eigen(from_middle @ from_middle.T)[1][:, 0]
    return _characteristic(
        of, name, symbol, vdi, shell(normal @ from_middle, share), "mm", points.shape[1]
    )


def _worst(values):
    return max(values, key=lambda name: abs(values[name]))


def _characteristic(of, name, symbol, vdi, value, unit, n, **optional) -> Characteristic:
    definition = inspect.getdoc(of).replace("\n\n", "\n").replace("\n", " ")
    return Characteristic(name, symbol, vdi, definition, value, unit, n, **optional)


def _undetermined(of, name, symbol, vdi, unit, why) -> Characteristic:
    return _characteristic(of, name, symbol, vdi, float("nan"), unit, 0, why=why)
