"""Possible readings of flange poses and target poses, and how well one hand-eye transform explains each.

Flange and camera rotate by the same angle between two poses, whatever the hand-eye transform (Chen, CVPR 1991). Pairs
of rotation conventions are screened by these angles, then by the closed form with the camera on the flange or not,
and the target's poses as recorded or inverted. The best are fitted as hand-eye problems, in every unit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.importers.mapping.candidates import (
    RotationConvention,
    length_units,
    rotation_candidates,
)
from datasets.importers.mapping.columns.column_units import unit_words
from datasets.importers.mapping.conversion import point_columns
from datasets.importers.mapping.model import Group, Mapping
from datasets.importers.source import RawTable
from sensors.hand_eye.checks.alternatives import moved_of
from sensors.hand_eye.checks.pose_fit import approximate_misfit, fit_poses
from sensors.hand_eye.target_poses import TargetPoses
from workbench.core.errors import InputError
from workbench.core.least_squares.linear_algebra import least_squares
from workbench.core.rigid import inverse, nearest_rotation, rotation_vector, transform
from workbench.recordings.importing.interpretation.fits import CandidateFit

_TESTED = 24
_PAIRS, _LINEAR_KEPT, _FITTED = 96, 8, 8
_CLOSE, _CLOSE_SHARE = 2.0, 0.01
_WIDEST_M = 10.0
"""Positions beyond it are not in metres."""
_GOOD_MM, _GOOD_SHARE = 5.0, 0.05
"""A good reading scatters the target by less than this, or less than this share of its distance from the camera and of
the motion of the flange: in units that make the distance too large, any misfit is a small share of it."""
_KEPT = 0.5  # of the pairs of poses: a few wrong rows must not decide
_USUAL = 3
_FAR_BETTER = 0.25
"""Share of the gap of the angles: most conventions differ by much more, and the noise of the poses by less."""
_WORDS = {"in-hand": "camera on the flange", "to-hand": "target on the flange"}
FIXED_TO = {"in-hand": "base", "to-hand": "tool"}
"""What the target is fixed to."""


@dataclass(frozen=True)
class TargetReading:
    """One reading: its `mapping`, `poses` of all rows, and whether the target's poses are `inverted` in the file."""

    title: str
    mapping: Mapping
    poses: TargetPoses
    inverted: bool

    @property
    def line(self) -> str:
        """What a mapping file says to state this reading."""
        groups = self.mapping.flange_rotation, self.mapping.rotation
        lines = [
            f'[{name}] convention = "{group.convention}"'
            for name, group in zip(("flange_rotation", "rotation"), groups)
        ]
        return f'{", ".join(lines)} and [board] fixed_to = "{FIXED_TO[self.poses.kind]}"'


def compared_readings(
    rows: RawTable, mapping: Mapping
) -> tuple[list[TargetReading], list[tuple[int, CandidateFit]]]:
    """Readings, and index and fit of those that were fitted, the most probable first.

    Raises InputError where the rotation columns hold no rotations.
    """
    readings = _readings(rows, mapping)
    tested_rows = np.unique(np.linspace(0, rows.n - 1, min(rows.n, _TESTED)).astype(int))
    quick = np.array([_rough(reading.poses, tested_rows) for reading in readings])
    order = np.argsort(quick, kind="stable")[:_FITTED]
    fits = [(int(k), _fit(readings[k], tested_rows)) for k in order]
    return readings, sorted(fits, key=lambda item: item[1].improbability)


def usual_readings(rows: RawTable, mapping: Mapping) -> list[TargetReading]:
    """Readings in which both sets have the same rotation convention, the few under which
    their relative rotations agree best, each with the units and directions that fit best."""
    of_flange, of_target = (
        _turns(group, rows) for group in (mapping.flange_rotation, mapping.rotation)
    )
    misfit = _misfits(rows, of_flange, of_target)
    pairs = [
        (misfit[i, j], i, j)
        for i, flange_reading in enumerate(of_flange)
        for j, target_reading in enumerate(of_target)
        if (flange_reading.group.convention, flange_reading.group.unit)
        == (target_reading.group.convention, target_reading.group.unit)
    ]
    chosen = []
    for _, i, j in sorted(pairs)[:_USUAL]:
        turns = [(of_flange[i], of_target[j])]
        readings = _readings_of(rows, mapping, turns)
        all_rows = np.arange(rows.n)
        chosen.append(min(readings, key=lambda reading: _rough(reading.poses, all_rows)))
    return chosen


def most_consistent(
    usual: TargetReading, readings: Sequence[TargetReading], rows: RawTable
) -> TargetReading:
    """The usual reading, or of those whose relative rotations agree far better the one with the least misfit."""
    tested_rows = np.unique(np.linspace(0, rows.n - 1, min(rows.n, _TESTED)).astype(int))
    limit = _FAR_BETTER * _angle_gap(usual.poses, tested_rows)
    better = [reading for reading in readings if _angle_gap(reading.poses, tested_rows) < limit]
    if not better:
        return usual
    return min(
        better, key=lambda reading: approximate_misfit(_taken(reading.poses, tested_rows).data)
    )


def _angle_gap(poses: TargetPoses, rows: np.ndarray) -> float:
    """Mean difference of the angles between two poses of flange and target, as a share of the flange's."""
    flange, seen = (_angles(matrices[rows][:, :3, :3]) for matrices in (poses.flange, poses.seen))
    gaps = np.sort(np.abs(flange - seen))[: int(np.ceil(_KEPT * len(flange)))]
    return float(gaps.mean() / max(np.sqrt((flange**2).mean()), 1e-9))


def _readings(rows: RawTable, mapping: Mapping) -> list[TargetReading]:
    return _readings_of(rows, mapping, _agreeing_turns(rows, mapping))


def _readings_of(rows: RawTable, mapping: Mapping, turns) -> list[TargetReading]:
    """turns: pairs of the rotation conventions of flange and target."""
    names = [f"row {line}" for line in rows.lines]
    readings = []
    for of_flange, of_target, kind, inverted in _turned(rows, mapping, turns):
        for flange_unit, unit in _unit_pairs(rows, mapping):
            chosen = replace(mapping, flange_rotation=of_flange.group, rotation=of_target.group)
            chosen = chosen.updated("flange_point", unit=flange_unit).updated("point", unit=unit)
            flange = _placed(rows, chosen.flange_point, of_flange)
            seen = _placed(rows, chosen.point, of_target)
            units = (
                unit_words(flange_unit, chosen.flange_point.columns, str),
                unit_words(unit, chosen.point.columns, str),
            )
            title = f"flange {of_flange.title}, {units[0]}; target {of_target.title}, {units[1]}"
            inversion = ", its poses inverted" if inverted else ""
            poses = TargetPoses(flange, inverse(seen) if inverted else seen, kind, names)
            readings.append(
                TargetReading(f"{title}{inversion}; {_WORDS[kind]}", chosen, poses, inverted)
            )
    return readings


def _turned(
    rows: RawTable, mapping: Mapping, turns
) -> list[tuple[RotationConvention, RotationConvention, str, bool]]:
    """Conventions, place of the camera and direction of the target's poses that one transform connects best."""
    tested_rows = np.unique(np.linspace(0, rows.n - 1, min(rows.n, _TESTED)).astype(int))
    part = rows.take(tested_rows)
    flange_unit, unit = _unit_pairs(rows, mapping)[0]
    stated = mapping.updated("flange_point", unit=flange_unit).updated("point", unit=unit)
    found = []
    for of_flange, of_target in turns:
        flange = _placed(part, stated.flange_point, of_flange)
        seen = _placed(part, stated.point, of_target)
        for kind in _kinds(mapping):
            moved = moved_of(flange, kind)
            for inverted in (False, True):
                misfit = _linear_misfit(moved, inverse(seen) if inverted else seen)
                found.append((misfit, len(found), of_flange, of_target, kind, inverted))
    found.sort(key=lambda row: row[:2])
    return [row[2:] for row in found[:_LINEAR_KEPT]]


def _linear_misfit(moved: np.ndarray, seen: np.ndarray) -> float:
    """Share of the relative motions of the flange (n, 4, 4) that the target's (n, 4, 4) leave, in any unit of length.

    The rotation by Park & Martin, IEEE Trans. Robot. Autom. 10 (1994), then (R_A - 1) t_X = s R_X t_B - t_A for the
    translation and the ratio s of the units.
    """
    i, j = np.triu_indices(len(moved), 1)
    flange = inverse(moved[j]) @ moved[i]
    target = seen[j] @ inverse(seen[i])
    alpha = rotation_vector(flange[:, :3, :3])
    beta = rotation_vector(target[:, :3, :3])
    rotation = nearest_rotation((alpha.T @ beta)[None])[0]
    shift = flange[:, :3, 3]
    turned = target[:, :3, 3] @ rotation.T
    design = np.concatenate([flange[:, :3, :3] - np.eye(3), -turned[:, :, None]], axis=2)
    solution = least_squares(design.reshape(-1, 4), -shift.ravel(), 1e-9)
    if solution[3] <= 0:
        return np.inf
    gaps = (alpha - beta @ rotation.T, design @ solution + shift)
    return sum(
        _trimmed_length(gap) / max(_trimmed_length(size), 1e-9)
        for gap, size in zip(gaps, (alpha, shift))
    )


def _trimmed_length(vectors: np.ndarray) -> float:
    """Mean length of the shortest of vectors (n, 3): a few wrong rows must not decide."""
    lengths = np.sort(np.linalg.norm(vectors, axis=1))
    return float(lengths[: int(np.ceil(_KEPT * len(lengths)))].mean())


def _kinds(mapping: Mapping) -> Sequence[str]:
    """Places of the camera: the one that [board] fixed_to of the mapping states, or both."""
    stated = (mapping.board or {}).get("fixed_to")
    return [kind for kind, fixed in FIXED_TO.items() if stated in (None, fixed)]


def _placed(rows: RawTable, point: Group, turn: RotationConvention) -> np.ndarray:
    translation = np.stack(list(point_columns(rows, point).values()), 1)
    return transform(turn.matrices(rows), translation)


def _unit_pairs(rows: RawTable, mapping: Mapping) -> list[tuple]:
    """Units of the flange's and of the target's positions.

    Only their ratio can be tested: where neither is stated, the size of the flange's positions decides.
    """
    flange = length_units(mapping.flange_point)
    target = length_units(mapping.point)
    if len(flange) > 1 and len(target) > 1:
        largest = max(np.abs(rows.columns[name]).max() for name in mapping.flange_point.columns)
        flange = ("mm",) if largest > _WIDEST_M else ("m",)
    return [(flange_unit, target_unit) for flange_unit in flange for target_unit in target]


def angle_misfit(rows: RawTable, flange: Group, target: Group) -> float:
    """By which the relative rotations of flange and target differ under their best conventions, see `_misfits`."""
    try:
        misfit = _misfits(rows, _turns(flange, rows), _turns(target, rows))
        return float(misfit.min())
    except InputError:
        return np.inf


def _agreeing_turns(
    rows: RawTable, mapping: Mapping
) -> list[tuple[RotationConvention, RotationConvention]]:
    """Pairs of rotation conventions under which flange and target rotate by the same angles, the best first."""
    of_flange, of_target = (
        _turns(group, rows) for group in (mapping.flange_rotation, mapping.rotation)
    )
    misfit = _misfits(rows, of_flange, of_target)
    order = np.argsort(misfit, axis=None, kind="stable")[:_PAIRS]
    places = [np.unravel_index(k, misfit.shape) for k in order]
    limit = _CLOSE * misfit.min() + _CLOSE_SHARE
    turns = []
    for i, j in places:
        if misfit[i, j] <= limit:
            turns.append((of_flange[i], of_target[j]))
    return turns


def _misfits(
    rows: RawTable,
    of_flange: Sequence[RotationConvention],
    of_target: Sequence[RotationConvention],
) -> np.ndarray:
    """(F, T) mean difference of the angles between two poses under each pair of conventions, as a share of them.

    Of numbers in radians that are read as degrees, all angles and differences are small."""
    tested_rows = np.unique(np.linspace(0, rows.n - 1, min(rows.n, _TESTED)).astype(int))
    angles = [
        np.array([_angles(turn.matrices(rows)[tested_rows]) for turn in turns])
        for turns in (of_flange, of_target)
    ]
    gaps = np.abs(angles[0][:, None] - angles[1][None])
    kept = int(np.ceil(_KEPT * gaps.shape[2]))
    size = np.sqrt((angles[0] ** 2).mean(1)[:, None] + (angles[1] ** 2).mean(1)[None])
    return np.sort(gaps, axis=2)[..., :kept].mean(2) / np.maximum(size, 1e-9)


def _turns(group: Group, rows: RawTable) -> list[RotationConvention]:
    """Readings of rotation columns; a transposed rotation with a position that is not inverted only where stated."""
    found = rotation_candidates(group, rows)
    found = [turn for turn in found if turn.group.inverse == group.inverse]
    if not found:
        raise InputError(
            f"{rows.file}, columns {', '.join(group.columns)}: expected rotations, found numbers that are none "
            "(quaternions of length 1, orthogonal matrices); correct the columns or the mapping."
        )
    return found


def _angles(rotations: np.ndarray) -> np.ndarray:
    """rad, between all pairs of rotations (n, 3, 3)."""
    i, j = np.triu_indices(len(rotations), 1)
    trace = np.einsum("nij,nij->n", rotations[i], rotations[j])
    return np.arccos(np.clip((trace - 1) / 2, -1, 1))


def _taken(poses: TargetPoses, rows: np.ndarray) -> TargetPoses:
    return replace(poses, flange=poses.flange[rows], seen=poses.seen[rows])


def _rough(poses: TargetPoses, rows: np.ndarray) -> float:
    """Closed-form misfit as a share of the distance to the target, so that no unit looks better than another."""
    taken = _taken(poses, rows)
    return approximate_misfit(taken.data) / _distance(taken)


def _distance(poses: TargetPoses) -> float:
    """Median distance of target and camera, mm."""
    return max(float(np.median(np.linalg.norm(poses.seen[:, :3, 3], axis=1))), 1e-9)


def _fit(reading: TargetReading, rows: np.ndarray) -> CandidateFit:
    taken = _taken(reading.poses, rows)
    fit = fit_poses(taken.data)
    rms, distance = fit.trimmed_rms, _distance(taken)
    shift = taken.flange[:, :3, 3] - taken.flange[:, :3, 3].mean(axis=0)
    extent = min(distance, float(np.linalg.norm(shift, axis=1).max()))
    is_good = rms < max(_GOOD_MM, _GOOD_SHARE * extent)
    degrees = max(6 * len(rows) - 12, 6)
    improbability = degrees * np.log(max(rms / distance, 1e-6))
    return CandidateFit(reading.title, rms, np.nan, rms, improbability, bool(is_good))
