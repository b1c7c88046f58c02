"""`distance`: lengths between a reflector's places in two rows, by ball bar or interferometer.

A sample is a pair of rows. The arm has a pose in both (`poses_per_sample` = 2): state and derivatives have a column
an end, first all first ends, then all second ones, and the two of a pair add up to what one length sees.
Nothing says where the arm stands.
"""

from dataclasses import dataclass, replace

import numpy as np

from datasets.recording import OTHER
from robot_model.chain import Frames
from robot_model.measurements.closure import (
    Closure,
    add_delta,
    flange_matrices,
    moved_target,
    numbered,
    position_sigma,
)
from robot_model.measurements.external_point import ExternalPoint
from workbench.core.errors import InputError
from workbench.core.parameters import Parameter

_STEPS = 60
_LINKS = ("pose", "repeat")


def paired(recording):
    """One row a pair: that of its first row, followed by the second row's columns, called `other_...`.

    A recording that is already so comes back as it is. InputError where a pair has not two rows.
    """
    if "pair" not in recording.columns or OTHER + "sample" in recording.columns:
        return recording
    pairs, group, count = np.unique(
        recording.columns["pair"], return_inverse=True, return_counts=True
    )
    if (count != 2).any():
        worst = int(np.argmax(count != 2))
        raise InputError(
            f"samples.csv of recording '{recording.name}', column pair: expected two rows of the tool with one pair, "
            f"found {count[worst]} with {pairs[worst]:g}; add the other end or take the row out"
        )
    rows = np.argsort(group.ravel(), kind="stable").reshape(-1, 2)
    rows = rows[np.argsort(rows[:, 0])]  # in the order in which they were measured
    first = recording.select(rows[:, 0])
    second = recording.select(rows[:, 1])
    columns = dict(first.columns) | {
        OTHER + name: column for name, column in second.columns.items()
    }
    for name in _LINKS:  # a repeat of a length is a repeat of both its ends
        if name in recording.columns:
            both_columns = np.stack([columns[name], columns[OTHER + name]])
            columns[name] = (
                np.unique(both_columns, axis=1, return_inverse=True)[1].ravel().astype(float)
            )
    return replace(first, columns=columns)


def second_ends(recording):
    """The second rows of a recording that is `paired`, under their own names."""
    columns = {
        name.removeprefix(OTHER): column
        for name, column in recording.columns.items()
        if name.startswith(OTHER)
    }
    return replace(recording, columns=columns)


@dataclass(frozen=True)
class Distance:
    """N lengths (N,) mm; `index` (2 N,) which of the reflectors `ids` is at each end."""

    lengths: np.ndarray
    index: np.ndarray
    ids: tuple[int, ...]
    place = "tool"
    grounded = True
    poses_per_sample = 2

    @classmethod
    def of(cls, recording) -> "Distance":
        """From a recording that is `paired`."""
        reflectors = np.concatenate([recording.reflector, second_ends(recording).reflector])
        ids, index = numbered(reflectors)
        return cls(recording.columns["length_mm"], index, ids)

    def parameters(self) -> list[Parameter]:
        """Three coordinates a reflector, flange frame, mm."""
        return ExternalPoint(np.zeros((3, 0)), self.index, self.ids).parameters()

    @property
    def measured(self) -> np.ndarray:
        """(1, 2 N) mm: the length, at either end."""
        return np.tile(self.lengths, 2)[None]

    @property
    def numbers(self) -> np.ndarray:
        """(2 N,) number of the reflector at each end, as in the file."""
        return np.asarray(self.ids)[self.index]

    def targets(self, values: np.ndarray) -> np.ndarray:
        """(3, 2 N) places of the reflectors on the flange, mm."""
        return values.reshape(-1, 3)[self.index].T

    def sigma(self, recording) -> np.ndarray:
        """(1, N) mm of a length; 1 where the recording does not say."""
        return position_sigma(recording)[:1]

    def at(self, samples: np.ndarray) -> "Distance":
        index_pairs = self.index.reshape(2, -1)[:, samples]
        return replace(self, lengths=self.lengths[samples], index=index_pairs.ravel())

    def close(self, frames: Frames, values: np.ndarray, deltas: dict) -> Closure:
        """(1, 2 N): half of predicted minus measured length at either end, mm, which add up to the whole."""
        axes = np.stack(frames.end)
        point = moved_target(frames.point(self.targets(values)), axes, deltas)
        if "sensor" in deltas:
            point = add_delta(point, deltas["sensor"])
        difference = np.diff(point.reshape(3, 2, -1), axis=1)[:, 0]
        length = np.sqrt((difference**2).sum(0))
        direction = difference / np.maximum(length, 1e-12)
        out = np.concatenate([-direction, direction], axis=1)  # away from the other end
        is_of_point = np.arange(len(self.ids))[:, None] == self.index
        by_flange = (axes * out).sum(1)
        tool_rows = (is_of_point[:, None] * by_flange).reshape(-1, 1, len(self.index))
        ports = {"target": by_flange[:, None], "sensor": out[:, None]}
        return Closure(
            np.tile(length - self.lengths, 2)[None] / 2,
            point,
            lambda rows: (rows * out).sum(1)[:, None],
            tool_rows,
            ports,
            to_world=lambda gap: direction * gap,
        )

    def start(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """Reflectors by Gauss-Newton from where the squared lengths, with products as unknowns, put one for all."""
        rotations = flange_matrices(frames)
        origins = frames.end_origin.T
        half = len(self.lengths)
        relative_rotation = rotations[half:] - rotations[:half]
        shift = origins[half:] - origins[:half]
        values = np.tile(_lifted(relative_rotation, shift, self.lengths), len(self.ids))
        return np.zeros(0), self._refined(frames, values)

    def _refined(self, frames, values):
        """Steps halved until the lengths fit better; what they do not show stays where it is."""
        gap, rows = self._gaps(frames, values)
        for _ in range(_STEPS):
            move = -np.linalg.lstsq(rows.T, gap, rcond=1e-6)[0]
            while (
                np.abs(move).max() > 1e-6
                and (self._gaps(frames, values + move)[0] ** 2).sum() >= (gap**2).sum()
            ):
                move = move / 2
            if np.abs(move).max() <= 1e-6:
                break
            values = values + move
            gap, rows = self._gaps(frames, values)
        return values

    def _gaps(self, frames, values):
        """(N,) predicted minus measured lengths and (3 R, N) their derivative."""
        closure = self.close(frames, values, {})
        rows = closure.tool_rows[:, 0].reshape(len(values), 2, -1).sum(1)
        return 2 * closure.residual[0, : len(self.lengths)], rows

    def columns(self, residual: np.ndarray) -> dict[str, np.ndarray]:
        """Columns of samples.csv for what was predicted: the length plus its residual (1, N)."""
        return {"length_mm": self.lengths + residual[0]}


def _lifted(rotation, shift, lengths):
    """(3,) x with |rotation x + shift| nearest lengths, from x and its products x x' as nine free unknowns.

    rotation (N, 3, 3), shift (N, 3): |rotation x + shift|^2 - length^2 is linear in both.
    """
    scale = max(float(np.abs(lengths).max()), 1.0)
    square = np.einsum("nki,nkj->nij", rotation, rotation)
    i, j = np.triu_indices(3)
    products = square[:, i, j] * np.where(i == j, 1, 2)
    by_x = 2 * np.einsum("nk,nki->ni", shift / scale, rotation)
    right = (lengths**2 - (shift**2).sum(1)) / scale**2
    return np.linalg.lstsq(np.hstack([by_x, products]), right, rcond=1e-8)[0][:3] * scale
