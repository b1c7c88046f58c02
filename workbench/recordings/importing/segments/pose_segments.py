"""Refusal of a pose table whose unit or rotation convention changes at a row, found on the board in the images.

As `row_segments` for a robot: a block of rows that fits under one reading determines flange to target and base to
target (an anchor). Every row is then compared under every reading there, and the division of the rows with the least
cost has a penalty for every change.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from datasets.importers.mapping.columns.column_units import unit_words
from datasets.importers.mapping.model import Mapping
from workbench.core.errors import InputError
from workbench.core.rigid import inverse, rotation_vector
from workbench.recordings.importing.segments.row_segments import (
    Segment,
    least_cost_labels,
    segments_of,
)

_FEWEST_ROWS = 6
_BLOCK_COUNTS = (1, 2, 3)
_MOST_COST, _PREFERRED = 9.0, 0.99
_GOOD_FACTOR = 3.0
_LEAST_MM, _LEAST_RAD = 1.0, np.deg2rad(0.3)
_FEWEST_IN_SEGMENT = 2
_EXPLAINED = 0.9


@dataclass(frozen=True)
class PoseReadings:
    """Every reading of a pose table on the board in P images.

    `readings`: (title, mapping, poses (n, 4, 4)) each. `rows` (P,): row of each image. `measured` (L, P, 4, 4): pose of
    the target that the flange carries, in the frame that stands still, under each labelling of the board. `best`: of
    some images (places), index of the reading that fits them best, None where none does. `solve`: of poses and targets
    (m, 4, 4), the transform (4, 4) from flange to target, and the pose of the base in the frame of the targets.
    """

    readings: Sequence
    rows: np.ndarray
    measured: np.ndarray
    best: Callable[[np.ndarray], tuple[int, np.ndarray] | None]
    solve: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def refuse_changed_poses(found: PoseReadings, table) -> None:
    """Raise InputError where parts of the rows need different readings; table: of the poses, for sentences."""
    for block in _blocks(len(found.rows)):
        best = found.best(block)
        if best is None:
            continue
        anchor, labels = best
        costs = _costs(found, block, anchor, labels)
        divided = segments_of(least_cost_labels(costs), len(costs))
        if _is_change(divided, costs):
            raise InputError(_sentence(found, divided, table))
        if _explained(costs[anchor]):
            return  # the other rows are gross errors


def _blocks(count: int) -> Iterator[np.ndarray]:
    """Neighbouring images: all, halves and thirds, as far as they determine the transforms."""
    for block_count in _BLOCK_COUNTS:
        if count // block_count >= _FEWEST_ROWS:
            yield from np.array_split(np.arange(count), block_count)


def _costs(found: PoseReadings, block, anchor: int, labels: np.ndarray) -> np.ndarray:
    """(k, P) squared gaps of the images under every reading, in units of what a sound arm leaves, bounded."""
    poses = np.stack([recording[found.rows] for _, _, recording in found.readings])
    pose = poses[anchor][block]
    sensor, base = found.solve(pose, found.measured[labels, block])
    # every image may be labelled in another way than those of the block
    gaps = [_gaps(poses, sensor, base, measured) for measured in found.measured]
    place = np.min([gap[0] for gap in gaps], axis=0)
    turn = np.min([gap[1] for gap in gaps], axis=0)
    good_mm = max(_LEAST_MM, _GOOD_FACTOR * float(np.median(place[anchor, block])))
    good_rad = max(_LEAST_RAD, _GOOD_FACTOR * float(np.median(turn[anchor, block])))
    costs = np.minimum((place / good_mm) ** 2 + (turn / good_rad) ** 2, _MOST_COST)
    costs[anchor] *= _PREFERRED
    return costs


def _gaps(poses, sensor, base, measured) -> tuple[np.ndarray, np.ndarray]:
    """(k, P) mm and rad between predicted and measured targets for flange poses (k, P, 4, 4)."""
    predicted = base @ poses @ sensor
    motion = inverse(measured) @ predicted
    turn = np.linalg.norm(rotation_vector(motion[..., :3, :3]), axis=-1)
    gap = np.linalg.norm(motion[..., :3, 3], axis=-1)
    return gap, turn


def _is_change(divided: Sequence[Segment], costs: np.ndarray) -> bool:
    """Whether two readings hold for two rows or more each, and explain nearly all rows."""
    if len({segment.reading for segment in divided}) < 2:
        return False
    lengths = [segment.last - segment.first + 1 for segment in divided]
    chosen = np.concatenate(
        [costs[segment.reading, segment.first : segment.last + 1] for segment in divided]
    )
    return min(lengths) >= _FEWEST_IN_SEGMENT and _explained(chosen)


def _explained(costs: np.ndarray) -> bool:
    """Whether nearly all rows fit, from their costs."""
    return bool((costs < _MOST_COST / 2).mean() >= _EXPLAINED)


def _sentence(found: PoseReadings, divided: Sequence[Segment], table) -> str:
    mappings = [found.readings[segment.reading][1] for segment in divided]
    words = [_words(mapping) for mapping in mappings]
    keys = [
        key for key in words[0] if len({words_of_segment[key] for words_of_segment in words}) > 1
    ]
    sentences = []
    for segment, description in zip(divided, words):
        first = table.lines[found.rows[segment.first]]
        last = table.lines[found.rows[segment.last]]
        sentences.append(
            f"{' and '.join(description[key] for key in keys)} in rows {first} to {last}"
        )
    names = dict.fromkeys(name for key in keys for name in _columns(mappings[0], key))
    return (
        f"{table.file}, columns {', '.join(names)}: expected one unit and convention in all rows, found "
        f"{', '.join(sentences[:-1])} and {sentences[-1]}, with which the poses fit the images; convert one of the "
        "parts, or import each as a table of its own."
    )


def _words(mapping: Mapping) -> dict[str, str]:
    """Interpretation of position and rotation, or of joint readings, in words."""
    if mapping.flange_rotation is None:
        return {"joints": unit_words(mapping.joints.unit, mapping.joints.columns, str)}
    group, point = mapping.flange_rotation, mapping.flange_point
    if group.unit:
        unit = f" in {unit_words(group.unit, group.columns, str)}"
    else:
        unit = ""
    turned = ", inverse" if group.inverse else ""
    return {
        "flange_point": f"{unit_words(point.unit, point.columns, str)}",
        "flange_rotation": f"{group.convention}{unit}{turned}",
    }


def _columns(mapping: Mapping, key: str) -> tuple[str, ...]:
    return getattr(mapping, key).columns
