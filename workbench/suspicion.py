"""What looks wrong with a recording that no base and tool bring near its robot: signs, units, order, labels."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from datasets.columns import MEASURED, POINT, QUATERNION, joint_columns
from datasets.errors import complaint
from datasets.recording import OTHER
from robot_model.measurements import second_ends
from robot_model.robot import Robot
from robot_model.system import bind
from workbench.core.model import Model
from workbench.core.solve import solve
from workbench.plans import frames_of

# mm: below this a data sheet's errors, zero offsets and sag are as likely as a mistake
_LOOK = 5.0
# a mistake that is put right leaves a small part of the error; a wrong guess hardly lowers it
_FALLS = 5.0
_WARN_MM, _WARN_REACH = 20.0, 0.02
_ROWS, _STEPS, _MOST_BALLS = 200, 6, 10
_TRIM = 0.05
_FAR, _NEAR = 10.0, 3.0
_UNITS = {10.0: "cm", 25.4: "inches", 1000.0: "m", 0.1: "tenths of a mm", 0.001: "um"}
Columns = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Suspicion:
    """One sentence on what looks wrong; `certain` where one mistake explains nearly all of the error."""

    sentence: str
    certain: bool


@dataclass(frozen=True)
class _Guess:
    """A mistake that may have been made, and how the columns would read without it.

    `scale`: by which the points grow, so that shrinking them does not pass for fitting them.
    `plain`: a single mistake, preferred over one that is made up of several.
    """

    where: str
    seems: str
    do: str
    undo: Callable[[Columns], dict]
    scale: float = 1.0
    plain: bool = True


def suspicion(robot: Robot, recording, nominal_rms_mm: float) -> Suspicion | None:
    """What looks wrong with a recording's columns, or None where nothing does.

    recording: its moving rows. nominal_rms_mm: 3-D error with base and tool fitted at the nominal
    geometry. Base and tool are fitted again under every mistake that is often made; the one that
    divides the error by `_FALLS` or more is named. The error here is the RMS of the best 95 % of
    the rows, so that a few lost beams make nothing look wrong. Takes under a second.
    """
    strange = _strange_rows(robot, recording)
    if nominal_rms_mm < _LOOK or strange:
        return strange
    found = _spread(robot, recording)
    if not np.isfinite(found):
        return None
    return _best_guess(robot, recording, found) or _far_off(robot, recording, found)


def _best_guess(robot, recording, found) -> Suspicion | None:
    """The plainest of the guesses that leave about the smallest error."""
    guesses = list(_guesses(robot, recording))
    errors = np.array([_spread_after(robot, recording, guess) for guess in guesses])
    if _FALLS * errors.min(initial=np.inf) > found:
        return None
    close = sorted(np.flatnonzero(errors <= 1.5 * errors.min()), key=lambda k: (not guesses[k].plain, errors[k]))
    best = guesses[close[0]]
    others = [guesses[k] for k in close[1:] if guesses[k].plain and best.plain]
    as_well = f" (as well explained: {others[0].where} {others[0].seems})" if others else ""
    sentence = complaint(
        f"samples.csv of recording '{recording.name}', {best.where}",
        "positions that belong to the joint readings",
        f"that base and tool at the nominal geometry fit to {found:.3g} mm as recorded, but to "
        f"{errors[close[0]]:.2g} mm if {best.where} {best.seems}{as_well}",
        best.do,
    )
    return Suspicion(str(sentence), True)


def _far_off(robot, recording, found) -> Suspicion | None:
    """No guess helps: only say so, where the error is more than any data sheet's."""
    reach = _reach(robot, recording)
    if found <= max(_WARN_MM, _WARN_REACH * reach):
        return None
    return Suspicion(
        f"samples.csv of recording '{recording.name}': base and tool alone fit to only {found:.3g} mm "
        f"({100 * found / reach:.2g} % of the arm's reach) at the nominal geometry, more than a data sheet's "
        "errors explain; check the robot's geometry and zero offsets, the units and signs of the columns, "
        "and that each row holds the joints and the position of one moment.",
        False,
    )


def _reach(robot, recording):
    """Sum of the nominal lengths and offsets, with the longest travel of sliding joints, mm."""
    travel = np.abs(robot.mixing @ recording.joints.T).max(1)[robot.prismatic]
    return float(np.abs(robot.geometry[:, 1:3]).sum() + travel.sum())


def _spread_after(robot, recording, guess: _Guess):
    columns = {**recording.columns, **guess.undo(recording.columns)}
    if recording.measures == "distance":  # the same mistake was made at both ends
        other = guess.undo({**recording.columns, **second_ends(recording).columns})
        columns |= {OTHER + name: column for name, column in other.items()}
    undone = replace(recording, columns=columns)
    return _spread(robot, undone) * max(1.0, 1 / guess.scale)


def _spread(robot, recording) -> float:
    """3-D RMS in mm of the best 95 % of rows with base and tool fitted; inf where there are too few rows."""
    try:
        fit = _fit(robot, recording.select(_subsample(recording)))
    except np.linalg.LinAlgError:
        return np.inf
    squares = np.sort((fit.residual[:3] ** 2).sum(0))
    spare = fit.residual.size - len(fit.normal)
    if spare < 6 or not np.isfinite(squares).all():
        return np.inf
    kept = squares[: len(squares) - int(_TRIM * len(squares))]
    return float(np.sqrt(kept.mean() * fit.residual.size / spare))


def _fit(robot, recording, loss="linear"):
    model = Model(bind(robot, recording))
    start = model.parameters
    return solve(model, start.only(start.matching(*frames_of(start))), loss, _STEPS)


def _subsample(recording) -> np.ndarray:
    """At most about `_ROWS` row numbers, evenly among the rows of every ball or reflector."""
    label = recording.ball if recording.measures == "ball-centre" else recording.reflector
    first = np.unique(label, return_index=True)[1]
    order = np.argsort(label, kind="stable")
    even = np.linspace(0, recording.n - 1, min(_ROWS, recording.n)).astype(int)
    return np.unique(np.concatenate([order[even], first]))


def _guesses(robot, recording) -> Iterator[_Guess]:
    """Every mistake that these columns may hold."""
    joints = joint_columns(recording.columns)
    turning = [c for c in joints if c.endswith("_deg")]
    yield from (_sign((c,)) for c in joints)
    yield from (_swapped(a, b) for a, b in combinations(joints, 2) if a[-3:] == b[-3:])
    yield from _radians(recording, turning)
    lengths = [c for c in (*POINT, "length_mm") if c in recording.columns]
    yield from (_unit(lengths, factor, unit) for factor, unit in _UNITS.items() if lengths)
    if set(POINT) <= set(recording.columns):
        yield from _mirrors(recording)
    yield from (_shifted(recording, step) for step in (1, -1))
    if recording.measures == "ball-centre":
        yield from _balls(recording)
    signs = [*combinations(joints, 2), *([tuple(joints)] if len(joints) > 2 else [])]
    yield from (_sign(names) for names in signs)


def _sign(names) -> _Guess:
    numbers = _listed([c[1:].split("_")[0] for c in names])
    what, seems, do = ("column", "has", "it") if len(names) == 1 else ("columns", "have", "them")
    return _Guess(
        f"{what} {_listed(names)}", f"{seems} the opposite sign",
        f"negate {do}, or write sign = -1 for joint {numbers} of the robot",
        lambda columns: {c: -columns[c] for c in names}, plain=len(names) == 1,
    )  # fmt: skip


def _listed(words) -> str:
    *most, last = map(str, words)
    return f"{', '.join(most)} and {last}" if most else last


def _swapped(a, b) -> _Guess:
    return _Guess(
        f"columns {a} and {b}", "are swapped", "swap them back", lambda columns: {a: columns[b], b: columns[a]}
    )


def _radians(recording, turning) -> Iterator[_Guess]:
    """Columns that stay within a turn of radians, each by itself and all together."""
    small = [c for c in turning if np.abs(recording.columns[c]).max() < 2.1 * np.pi]
    together = [tuple(turning)] if len(small) == len(turning) > 1 else []
    for names in [*((c,) for c in small), *together]:
        yield _Guess(
            f"column{'s' * (len(names) > 1)} {_listed(names)}",
            "holds radians" if len(names) == 1 else "hold radians", "write degrees",
            lambda columns, names=names: {c: np.rad2deg(columns[c]) for c in names},
        )  # fmt: skip


def _unit(names, factor, unit) -> _Guess:
    one = len(names) == 1
    return _Guess(
        f"column{'s' * (not one)} {_listed(names)}", f"{'holds' if one else 'hold'} {unit}",
        f"multiply {'it' if one else 'them'} by {factor:g}, or check the robot's lengths",
        lambda columns: {c: factor * columns[c] for c in names}, factor,
    )  # fmt: skip


def _mirrors(recording) -> Iterator[_Guess]:
    """Left-handed points; only beside orientations does it matter which axis is the wrong one."""
    if recording.measures != "external-pose":
        yield _Guess(
            f"columns {_listed(POINT)}", "are left-handed", "give one of them the opposite sign, or swap the two "
            "that are interchanged", lambda columns: {"x_mm": -columns["x_mm"]},
        )  # fmt: skip
        return
    for c in POINT:
        yield _Guess(f"column {c}", "has the opposite sign", "negate it", lambda columns, c=c: {c: -columns[c]})
    yield from (_swapped(a, b) for a, b in combinations(POINT, 2))
    vector = QUATERNION[1:]
    yield _Guess(
        f"columns {_listed(QUATERNION)}", "turn the other way", f"negate {_listed(vector)}",
        lambda columns: {c: -columns[c] for c in vector},
    )  # fmt: skip
    true = (*vector, "qw")
    yield _Guess(
        f"columns {_listed(QUATERNION)}", "hold the quaternion in the order x, y, z, w", "put them in order",
        lambda columns: {name: columns[old] for name, old in zip(true, QUATERNION)},
    )  # fmt: skip


def _shifted(recording, step) -> _Guess:
    """Positions one row late (step 1) or early; the row without a partner repeats its neighbour's mate."""
    observed = [c for c in recording.columns if c in MEASURED or c in ("ball", "reflector")]
    n = recording.n
    mine = np.clip(np.arange(n), max(0, -step), n - 1 - max(0, step))
    return _Guess(
        "rows", f"hold the position of the row {'after' if step < 0 else 'before'}",
        f"move the measured columns {'up' if step > 0 else 'down'} by one row",
        lambda columns: {c: v[mine + step if c in observed else mine] for c, v in columns.items()},
    )  # fmt: skip


def _balls(recording) -> Iterator[_Guess]:
    numbers = np.unique(recording.ball)
    for a, b in combinations(numbers, 2) if len(numbers) <= _MOST_BALLS else ():
        yield _Guess(
            f"column ball, numbers {a} and {b}", "are swapped", "swap them there or in artefact.csv",
            lambda columns, a=a, b=b: {"ball": _exchanged(columns["ball"], a, b)},
        )  # fmt: skip


def _exchanged(labels, a, b):
    return np.where(labels == a, b, np.where(labels == b, a, labels))


def _strange_rows(robot, recording) -> Suspicion | None:
    """Rows of ball-centre far from their ball that fit another ball; None where there are none.

    Only where most rows fit, so that the median distance is that of the right ones.
    """
    if recording.measures != "ball-centre" or len(recording.balls) < 2:
        return None
    distance, numbers = _distances(robot, recording)
    own = distance[np.searchsorted(numbers, recording.ball), np.arange(recording.n)]
    usual = np.median(own)
    strange = (own > max(_FAR * usual, _LOOK)) & (distance.min(0) < _NEAR * usual)
    if not strange.any() or usual > _WARN_MM:
        return None
    better = numbers[distance.argmin(0)]
    rows = [f"{i} ({was} for {is_})" for i, was, is_ in
            zip(recording.sample_ids[strange], recording.ball[strange], better[strange])]  # fmt: skip
    more = [f"{len(rows) - 8} more"] if len(rows) > 8 else []
    sentence = complaint(
        f"samples.csv of recording '{recording.name}', column ball",
        "the number of the ball that was measured",
        f"at least one other number, with which a row fits to {distance.min(0)[strange].max():.2g} mm instead of "
        f"{own[strange].min():.3g} mm or more: sample {_listed([*rows[:8], *more])}",
        "correct these numbers",
    )
    return Suspicion(str(sentence), True)


def _distances(robot, recording):
    """(K, n) mm from each row to the place of each of the K balls, base and tool fitted robustly."""
    numbers = np.array(sorted(recording.balls))
    rows = _subsample(recording)
    values = _fit(robot, recording.select(rows), "cauchy").parameters.values
    start = np.concatenate([values[:6], values[-6:]])  # base and hand-eye
    out = []
    for number in numbers:
        columns = {**recording.columns, "ball": np.full(recording.n, float(number))}
        model = Model(bind(robot, replace(recording, columns=columns), start))
        out.append(np.sqrt((model.residual(model.parameters) ** 2).sum(0)))
    return np.array(out), numbers
