"""Alternatives to the data as recorded, each fitted: a mistake undone, poses reassigned, a scale, a change."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from sensors.hand_eye.checks.mistakes import Reading
from sensors.hand_eye.checks.nouns import Nouns
from sensors.hand_eye.checks.permutation import best_permutation, permuted, reassigned
from sensors.hand_eye.checks.pose_data import Freedom, PoseData, PoseFit
from sensors.hand_eye.checks.pose_fit import approximate_misfit, fit_poses, refit
from workbench.core.rigid import inverse

OUTLIERS = "wrong-images"
_REFINED = 8
_REFINED_CHANGES = 3
# Images on each side of a change: with one, a change is the same as one wrong image.
_MIN_IMAGES = 2
_DIFFERENT = 4.0
# A scale nearer to one is a board's print or an arm's links, and belongs to the adjustment.
_LEAST_SCALE = 0.01
_OUTLYING = 5.0
_UNITS = {
    25.4: "inches",
    1000.0: "metres",
    100.0: "decimetres",
    10.0: "centimetres",
    304.8: "feet",
}


@dataclass(frozen=True)
class Alternative:
    """A hypothesis with its misfit.

    `misfit` mm, comparable with the recorded data's: of all images where `uses_all_images`, else of the best three
    quarters.
    `extra`: parameters added. `rank`: a plain mistake is preferred over one that explains anything. `grows`: by how
    much the alternative enlarges lengths. `falls`: the recorded misfit must be this many times as large.
    """

    cause: str
    symptom: str
    do: str
    misfit: float
    extra: int = 0
    rank: int = 0
    uses_all_images: bool = False
    grows: float = 1.0
    falls: float = 3.0

    def recorded(self, fitted) -> float:
        """mm, the misfit of the recorded data that this one is compared with."""
        return fitted.scatter_mm if self.uses_all_images else fitted.trimmed_mm


def reading_alternatives(
    data: PoseData, readings: Iterable[Reading], kind: str
) -> list[Alternative]:
    """The readings that fit best in closed form, fitted robustly."""
    tried = [(replace(data, moved=moved_of(reading.flange, kind)), reading) for reading in readings]
    ranked = sorted(tried, key=lambda row: approximate_misfit(row[0]))
    found = []
    for other, reading in ranked[:_REFINED]:
        fit = fit_poses(other)
        found.append(Alternative(reading.cause, reading.symptom, reading.do, fit.trimmed_rms))
    return found + [replace(found[-1], misfit=np.inf)] * (len(ranked) - len(found)) if found else []


def moved_of(flange: np.ndarray, kind: str) -> np.ndarray:
    """(P, 4, 4) the M_i of `pose_fit` from T_base_flange."""
    return flange if kind == "in-hand" else inverse(flange)


def scale_alternative(data: PoseData, nouns: Nouns) -> Iterator[Alternative]:
    """A common factor between the lengths that the camera sees and those of the flange."""
    if data.count < 3:
        return
    fit = fit_poses(data, Freedom(scale=True))
    log = float(np.log(fit.scale))
    std = fit.scale_std
    if not np.isfinite(std) or abs(log) < max(_DIFFERENT * std, _LEAST_SCALE):
        return
    symptom, do = _scale_words(fit.scale, std, nouns)
    # If it is the board that is too large, so is every length that the camera sees.
    yield Alternative(
        "scale", symptom, do, fit.trimmed_rms, 1, 1, grows=max(fit.scale, 1.0), falls=1.2
    )


def _scale_words(scale, std, nouns: Nouns):
    """Scale: by how much the flange positions must grow; std: 1 sigma of its logarithm."""
    factor = max(scale, 1 / scale)
    size = _with_std(factor, factor * std)
    flange, board = ("small", "large") if scale > 1 else ("large", "small")
    unit_names = [
        name for value, name in _UNITS.items() if abs(np.log(factor / value)) < max(3 * std, 0.02)
    ]
    wrong_lengths = "flange positions" if scale > 1 else nouns.size_name
    question = f" ({wrong_lengths} in {unit_names[0]}?)" if unit_names else ""
    symptom = (
        f"{nouns.size_subject} {size} times too {board}, or the flange positions {size} times too "
        f"{flange}{question}"
    )
    return symptom, f"correct {nouns.size_source}, or the unit of the flange positions"


def _with_std(value, std):
    decade = np.floor(np.log10(max(std, 1e-12)))
    digits = int(np.clip(1 - decade, 0, 6))
    if value < 100:
        digits = max(digits, 2)
    least_std = 10.0**-digits
    return f"{value:.{digits}f} ± {max(std, least_std):.{digits}f}"


def change_alternatives(data: PoseData, recorded: PoseFit, named) -> list[Alternative]:
    """A sensor, or a board, that has another pose from some image on; the best few are fitted, the others count."""
    places = range(_MIN_IMAGES, data.count - _MIN_IMAGES + 1)
    freedoms = [Freedom(sensor_from=k) for k in places] + [Freedom(board_from=k) for k in places]
    if not freedoms:
        return []
    starts = {k: _change_starts(data, recorded, k) for k in places}
    rough = [min(_changed(data, starts, freedom, True), key=_rms) for freedom in freedoms]
    ranked = sorted(range(len(freedoms)), key=lambda k: rough[k].rms)
    found = [
        min(_changed(data, starts, freedoms[k], False), key=_rms) for k in ranked[:_REFINED_CHANGES]
    ]
    alternatives = [_change(fit, named) for fit in found]
    return alternatives + [replace(alternatives[0], misfit=np.inf)] * (
        len(freedoms) - len(alternatives)
    )


def _rms(fit):
    return fit.rms


def _change_starts(data, recorded, first):
    """The recorded fit, and that of the longer part alone."""
    part = slice(0, first) if first >= data.count / 2 else slice(first, None)
    inner = PoseData(data.moved[part], data.seen[:, part], data.corners)
    if inner.count < 3:
        return [recorded]
    alone = fit_poses(inner)
    return [recorded, replace(recorded, sensor=alone.sensor, board=alone.board)]


def _changed(data, starts, freedom, rough):
    first = freedom.sensor_from if freedom.board_from is None else freedom.board_from
    return [refit(data, start, freedom, rough) for start in starts[first]]


def _change(fit, named) -> Alternative:
    freedom = fit.freedom
    first = freedom.sensor_from if freedom.board_from is None else freedom.board_from
    moved_body = _sensor_moved(named.kind) if freedom.board_from is None else _target_moved(named)
    symptom = f"{moved_body} moved between {named.images[first - 1]} and {named.images[first]}"
    do = f"split the recording there, or {named.nouns.repeat} with everything clamped"
    return Alternative("moved", symptom, do, fit.rms, 6, 2, True, falls=2.0)


def _sensor_moved(kind):
    return "the camera on the flange" if kind == "in-hand" else "the camera"


def _target_moved(named):
    carrier = " (or the base of the arm)" if named.kind == "in-hand" else " on the flange"
    return f"the {named.nouns.target}{carrier}"


def permutation_alternatives(data: PoseData, recorded: PoseFit, named) -> Iterator[Alternative]:
    """Poses given to other images: only those that fit nowhere, or all of them."""
    allowed = _OUTLYING * float(np.median(recorded.distance))
    order = reassigned(data, recorded, allowed)
    found = []
    if (order != np.arange(data.count)).any():
        found.append((order, fit_poses(permuted(data, order))))
    permutation_of_all = best_permutation(data)
    if permutation_of_all is not None and (permutation_of_all[0] != np.arange(data.count)).any():
        found.append(permutation_of_all)
    if found:
        order, fit = min(found, key=lambda row: row[1].rms)
        yield _permutation(order, fit, named)


def outlying(recorded: PoseFit) -> np.ndarray:
    """(P,) True for images whose distance is several times the median of all."""
    return recorded.distance > _OUTLYING * float(np.median(recorded.distance))


def outlier_alternative(data: PoseData, recorded: PoseFit) -> Iterator[Alternative]:
    """The images that fit worst left out, fewer than half of them: no mistake of all poses."""
    wrong = outlying(recorded)
    count = int(wrong.sum())
    if not 0 < 2 * count < data.count:
        return
    inner = PoseData(data.moved[~wrong], data.seen[:, ~wrong], data.corners)
    fit = fit_poses(inner, starts=[recorded.sensor[0]])
    yield Alternative(OUTLIERS, "", "", fit.rms, 6 * count, 3, True, falls=2.0)


def _permutation(order, fit, named) -> Alternative:
    moved = np.flatnonzero(order != np.arange(len(order)))
    names = [f"{named.images[k]} has the pose of {named.images[order[k]]}" for k in moved]
    remainder = f" and {len(names) - 6} more" if len(names) > 6 else ""
    if len(moved) == 2:
        symptom = (
            f"the poses of {named.images[moved[0]]} and {named.images[moved[1]]} look exchanged"
        )
    else:
        symptom = (
            f"{named.nouns.samples} and poses look permuted: {', '.join(names[:6])}{remainder}"
        )
    # Choosing among the orders of so many poses is a choice of this many parameters.
    extra = int(np.ceil(np.log(np.arange(1, len(moved) + 1)).sum() / np.log(6 * len(order)) * 2))
    return Alternative(
        "permuted",
        symptom,
        f"correct {named.nouns.order}",
        fit.rms,
        extra,
        1,
        True,
        falls=2.0,
    )
