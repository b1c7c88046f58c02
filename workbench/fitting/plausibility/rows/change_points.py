"""A sudden shift midway through a recording: base, instrument, artefact, tool or the zero of a joint has moved, or the
load of the tool has changed.

For every row k the parameters of a motion from row k on, six of base or tool or one of a joint, are added to the
linearised fit; of a load the deflection of each joint under it. The reduction of the sum of squares is the score
statistic of a change point (Csorgo & Horvath, Limit Theorems in Change-Point Analysis, 1997, ch. 3). Parameters of the
fit are projected out, so that what the geometry absorbs is no evidence.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from robot_model.measurements import end_recordings
from robot_model.measurements.ball_scan import FILE_KIND
from robot_model.measurements.ball_surface import numbers_of_scans
from workbench.core.errors import InputError
from workbench.core.least_squares.linear_algebra import pseudo_inverse
from workbench.fitting.plausibility.fitting import (
    POSITION,
    fit_recording,
    geometry_prior,
    lever_of,
    model_at,
    row_mismatch,
    tool_patterns,
)
from workbench.fitting.plausibility.rows.load_deflection import (
    CENTRE_MM,
    ROUNDS,
    LoadDeflection,
    of_one_sign,
)

_LEAST_ROWS = 6
_LEAST_GAIN = 2.0
"""Factor by which the RMS has to fall: smaller steps are a matter of the diagnosis, not of plausibility."""
_SIMPLER = 1.2
"""Factor of the RMS that a joint's zero, one number, may leave of what the six of base or tool leave, and that an
alternative may leave: errors of the arm that the fit does not contain make as much."""
_EXTREME = 12.0
_MOST_ROWS = 3000
_WORDS = {
    "base": {
        "ball-centre": "the artefact or the robot's base",
        "ball-surface": "the artefact or the robot's base",
        "": "the instrument or the robot's base",
    },
    "tool": {
        "ball-centre": "the sensor on the flange",
        "ball-surface": "the sensor on the flange",
        "": "the target on the flange",
    },
}


LOAD = "load"
_CHANGED = "the load of the tool"


@dataclass(frozen=True)
class ChangePoint:
    """`moved_object` moved between samples `before` and `after`; `gain`: factor by which that lowers the RMS to `scale`
    mm; `shift_mm`: RMS displacement of the measured points by the motion. `others`: objects whose motion explains the
    misfit about as well, the best first."""

    moved_object: str
    before: int
    after: int
    gain: float
    scale: float
    shift_mm: float
    others: tuple[str, ...] = ()

    @property
    def is_load(self) -> bool:
        """Whether the load of the tool has changed, and nothing has moved."""
        return self.moved_object == _CHANGED


def find_change_point(robot, recording, fit) -> ChangePoint | None:
    """The most likely instant at which base or tool moved, or None where no motion explains most of the misfit.

    fit: the reference fit, whose parameters are the point of linearisation.
    """
    order = time_order(recording)
    if recording.n > _MOST_ROWS:
        order = order[np.linspace(0, recording.n - 1, _MOST_ROWS).astype(int)]
    if len(order) < 4 * _LEAST_ROWS:
        return None
    ordered = recording.select(order)
    system = _System(robot, ordered, fit)
    if len(system.load):
        system.estimate_centre()
    joints = [f"joint-{number}" for number in range(1, robot.joints + 1)]
    places = [place for place in ("base", "tool", LOAD, *joints) if len(system.rows_of(place))]
    scans = {place: _scan(system, place) for place in places}
    unexplained = {place: system.squares - explained for place, (_, explained) in scans.items()}
    place = _likeliest(unexplained, _SIMPLER**2)
    others = _as_likely(unexplained, place, recording.measures)
    k, explained = scans[place]
    unexplained = max(unexplained[place], 1e-12)
    gain = float(np.sqrt(system.squares / unexplained))
    if gain < _LEAST_GAIN:
        return None
    moved_object = _moved_object(place, recording.measures)
    before, after = _neighbours(recording, order, k)
    scale = np.sqrt(unexplained / ordered.n)
    return ChangePoint(moved_object, before, after, gain, scale, system.shift(place, k), others)


def _as_likely(unexplained: Mapping[str, float], chosen: str, measures: str) -> tuple[str, ...]:
    """Objects at base, tool and load that leave hardly more than the chosen one, the best first."""
    limit = _SIMPLER**2 * max(unexplained[chosen], 1e-12)
    places = [p for p in ("base", "tool", LOAD) if p in unexplained and p != chosen]
    likely = [place for place in places if unexplained[place] <= limit]
    return tuple(_moved_object(p, measures) for p in sorted(likely, key=unexplained.get))


def _neighbours(recording, order, k: int) -> tuple[int, int]:
    """Numbers of the samples before and after row k of an order; of points on balls those of the scans.

    Nothing moves within a scan, so that the change is at the nearest of its ends.
    """
    if recording.measures != FILE_KIND:
        ids = recording.sample_ids[order]
        return int(ids[k - 1]), int(ids[k])
    numbers = numbers_of_scans(recording)[order]
    begins = np.flatnonzero(np.diff(numbers)) + 1
    if len(begins):
        k = begins[np.argmin(np.abs(begins - k))]
    return int(numbers[k - 1]), int(numbers[k])


def _likeliest(unexplained: Mapping[str, float], allowed: float) -> str:
    """The place that leaves least; a joint, which has one number, where it leaves hardly more than base and tool."""
    best = min(unexplained, key=unexplained.get)
    joints = [place for place in unexplained if place.startswith("joint-")]
    joint = min(joints, key=unexplained.get, default=best)
    if unexplained[joint] <= allowed * max(unexplained[best], 1e-12):
        return joint
    return best


def _moved_object(place: str, measures: str) -> str:
    """Object that has moved at a place, as the subject of a sentence."""
    if place == LOAD:
        return _CHANGED
    if place.startswith("joint-"):
        return f"the zero of {place.replace('-', ' ')} (lost counts, a slipped belt)"
    return _WORDS[place].get(measures, _WORDS[place][""])


def time_order(recording) -> np.ndarray:
    """(n,) row numbers in order of time, or as they stand where no time is recorded."""
    time = recording.columns.get("time_s")
    if time is None:
        return np.arange(recording.n)
    return np.argsort(time, kind="stable")


class _System:
    """Residual (n m,) and derivative of the linearised fit, both in mm, with the baseline projected out."""

    def __init__(self, robot, recording, fit):
        model, parameters = model_at(robot, recording, fit.parameters.values)
        parameters = parameters.only(fit.parameters.mask)
        lever = lever_of(robot, recording)
        prior = geometry_prior(robot, recording, parameters)
        residual, rows = model.linearise(parameters)
        residual[POSITION:] *= lever
        rows[:, POSITION:] *= lever
        mismatch = np.sqrt((residual**2).sum(0))
        # rows far beyond all others are blunders, which are looked for elsewhere
        is_usable = mismatch <= _EXTREME * max(np.quantile(mismatch, 0.75), 1e-9)
        self.keys = np.array(parameters.keys)[parameters.mask]
        self.rows = np.where(is_usable, rows, 0.0)
        self.residual = np.where(is_usable, residual, 0.0)
        noise = max(float(np.median(mismatch)) ** 2 / len(residual), 1e-6)
        precision = noise / prior[parameters.mask] ** 2
        flat = self.rows.reshape(len(rows), self.residual.size)
        matrix = flat @ flat.T + np.diag(precision)
        size = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-12))
        scaled = matrix * np.outer(size, size) + 1e-9 * np.eye(len(size))
        self.inverse = pseudo_inverse(scaled, 1e-9) * np.outer(size, size)
        gradient = flat @ self.residual.ravel()
        self.is_usable = is_usable
        self.deflection = LoadDeflection.of(model, parameters, lever)
        is_recorded = np.ptp(model.chain.state.payload) > 0
        if is_recorded or len(end_recordings(recording)) > 1:  # the ends of a length deflect apart
            self.load = np.zeros((0, *self.residual.shape))
        else:
            self.load = self._load_at(np.zeros(3))
        self.pose = recording.poses
        self.projected = self.residual - np.tensordot(self.inverse @ gradient, self.rows, 1)
        self.squares = float((self.projected**2).sum())
        self.n = residual.shape[1]

    def columns(self, place):
        """(F,) True for the parameters at a place: pose of "base", of "tool" for tool and sensor, zero of "joint-2"."""
        if place.startswith("joint-"):
            return self.keys == _zero_of(place)
        wanted = ("base.",) if place == "base" else ("tool.", "sensor.")
        return np.array([key.startswith(wanted) for key in self.keys], bool)

    def rows_of(self, place) -> np.ndarray:
        """(P, m, n) derivative of the residual by the motion of a place, or by the deflections under a load."""
        return self.load if place == LOAD else self.rows[self.columns(place)]

    def _load_at(self, centre) -> np.ndarray:
        return np.where(self.is_usable, self.deflection.rows(centre), 0.0)

    def estimate_centre(self) -> None:
        """Give the load the centre at which it explains most, from its likeliest instant on."""
        centre = np.zeros(3)
        for _ in range(ROUNDS):
            k, explained = _scan(self, LOAD)
            products = self.reductions(LOAD, [k])[0][0]
            if not products.any():
                return
            is_after = self.is_usable & (np.arange(self.n) >= k)
            by_centre = self.deflection.rows_by_centre(products)
            moved = np.where(is_after, by_centre, 0.0)
            projected = [self.without_baseline(column) for column in moved]
            columns = np.reshape(projected, (3, -1)).T
            by_load = np.tensordot(products, self.load, 1)
            deflected = np.where(is_after, by_load, 0.0)
            remainder = self.projected - self.without_baseline(deflected)
            unexplained = max(self.squares - explained, 1e-12)
            noise = np.sqrt(unexplained / self.residual.size)
            prior = noise / CENTRE_MM
            matrix = np.vstack([columns, prior * np.eye(3)])
            right = np.concatenate([remainder.ravel(), -prior * centre])
            centre = centre + np.linalg.lstsq(matrix, right, rcond=None)[0]
            self.load = self._load_at(centre)

    def without_baseline(self, values) -> np.ndarray:
        """(m, n) values less what the parameters of the fit make of them."""
        shared = self.rows.reshape(len(self.rows), -1) @ values.ravel()
        return values - np.tensordot(self.inverse @ shared, self.rows, 1)

    def reductions(self, place, splits):
        """(K, P) motions from each of K splits on, and the reductions (K,) of the sum of squares by them."""
        rows_of_place = self.rows_of(place)
        later = {
            "own": np.einsum("amn,bmn->nab", rows_of_place, rows_of_place),
            "cross": np.einsum("amn,fmn->naf", rows_of_place, self.rows),
            "gradient": np.einsum("amn,mn->na", rows_of_place, self.projected),
        }
        sums = {}
        for name, part in later.items():
            sums[name] = np.cumsum(part[::-1], axis=0)[::-1][splits]
        matrix = sums["own"] - sums["cross"] @ self.inverse @ sums["cross"].transpose(0, 2, 1)
        size = np.sqrt(np.maximum(np.einsum("kaa->ka", sums["own"]), 1e-12))
        matrix = matrix / (size[:, :, None] * size[:, None, :]) + 1e-7 * np.eye(len(rows_of_place))
        gradient = sums["gradient"] / size
        if place == LOAD:
            motion = np.stack([of_one_sign(*part) for part in zip(matrix, gradient)])
        else:
            motion = np.linalg.solve(matrix, gradient[..., None])[..., 0]
        return motion / size, (motion * gradient).sum(1)

    def splits(self, place) -> np.ndarray:
        """(K,) rows from which on a place may have moved.

        A load changes with `_LEAST_ROWS` poses before and after it: several targets at one pose show one deflection.
        """
        rows = np.arange(_LEAST_ROWS, self.n - _LEAST_ROWS + 1)
        if place != LOAD:
            return rows
        is_new = self.pose[1:] != self.pose[:-1]
        begins = np.concatenate([[True], is_new])
        count = np.cumsum(begins)
        before = count[rows - 1]
        after = count[-1] - before
        is_within = np.minimum(before, after) >= _LEAST_ROWS
        return rows[is_within & begins[rows]]

    def shift(self, place, k):
        """RMS displacement in mm of the points of the rows from k on."""
        motion, _ = self.reductions(place, [k])
        moved = np.tensordot(motion[0], self.rows_of(place)[:, :POSITION, k:], 1)
        return float(np.sqrt((moved**2).sum(0).mean()))


def _scan(system, place):
    """The split with the largest reduction of the sum of squares, and that reduction."""
    splits = system.splits(place)
    if not len(splits):
        return _LEAST_ROWS, 0.0
    _, reductions = system.reductions(place, splits)
    reductions = np.where(np.isfinite(reductions), reductions, 0.0)
    best = int(np.argmax(reductions))
    return int(splits[best]), float(reductions[best])


def find_new_setup(robot, recording, good: float) -> ChangePoint | None:
    """A move too large for a linearised fit: the first and the last rows fit separately, but not together.

    good: scale in mm of a good fit.
    """
    order = time_order(recording)
    quarter = max(recording.n // 4, 12)
    if recording.n < 3 * quarter:
        return None
    ordered = recording.select(order)
    first = _fit_of(robot, ordered, slice(0, quarter))
    last = _fit_of(robot, ordered, slice(-quarter, None))
    if first is None or last is None or max(first.core, last.core) > good:
        return None
    try:
        early, late = (row_mismatch(robot, ordered, fit) for fit in (first, last))
    except np.linalg.LinAlgError:  # a target was measured in one part only
        return None
    limit = _EXTREME * max(good, first.core, last.core)
    costs = [np.cumsum(np.minimum(part, limit) ** 2) for part in (early, late)]
    split = int(np.argmin(costs[0] + costs[1][-1] - costs[1]))
    before = np.median(early[: split + 1])
    if split + 1 < ordered.n:
        after = np.median(late[split + 1 :])
    else:
        after = np.inf
    if not max(before, after) < 3 * good or split + 1 > ordered.n - 4:
        return None
    place, shift = _what_moved(robot, ordered, (first, last), split + 1)
    scale = float(max(before, after))
    if shift < _LEAST_GAIN * scale:
        return None  # the first and the last rows agree: what does not fit lies between them
    moved_object = _moved_object(place, recording.measures)
    last_before, first_after = _neighbours(recording, order, split + 1)
    return ChangePoint(
        moved_object, last_before, first_after, shift / max(scale, 1e-9), scale, shift
    )


def _fit_of(robot, recording, rows):
    try:
        fit = fit_recording(robot, recording.select(np.arange(recording.n)[rows]))
    except (np.linalg.LinAlgError, InputError):
        return None
    return fit if np.isfinite(fit.scale) else None


def _what_moved(robot, recording, fits, split):
    """The base, the tool or a joint, whichever explains the later rows best when only it differs from the earlier fit,
    and how far it moves the measured points (RMS, mm)."""
    first, _ = fits
    later = recording.select(np.arange(split, recording.n))
    unexplained = {}
    zeros = {f"joint-{k}": (_zero_of(f"joint-{k}"),) for k in range(1, robot.joints + 1)}
    for place, patterns in {"base": ("base.*",), "tool": tool_patterns(later), **zeros}.items():
        try:
            start = fit_recording(robot, later).parameters
            values = np.where(start.matching(*patterns), start.values, first.parameters.values)
            unexplained[place] = fit_recording(robot, later, values, free=patterns, steps=30).scale
        except (np.linalg.LinAlgError, InputError):
            unexplained[place] = np.inf
    moved = row_mismatch(robot, later, first)
    shift = float(np.sqrt((moved**2).mean()))
    return _likeliest(unexplained, _SIMPLER), shift


def _zero_of(place: str) -> str:
    """Key of the zero offset of a joint; of a slide it is confounded with its length and not compared."""
    return f"{place}.theta{place.partition('-')[2]}"
