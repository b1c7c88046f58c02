"""`partial-pose`: a target on the flange, of which an external instrument gives point and one axis."""

from dataclasses import dataclass, replace

import numpy as np

from robot_model.chain import Frames, cross
from robot_model.measurements.closure import (
    Closure,
    add_delta,
    flange_matrices,
    kronecker_rows,
    moved_target,
)
from robot_model.measurements.external_point import base_values, point_system
from robot_model.measurements.external_pose import MeasuredPose
from robot_model.measurements.multistart import MODEL_ERROR_MM, RotationSystem, lever_arm
from workbench.core.rigid import left_jacobian, rotation_matrix

AXES = {("nx", "ny", "nz"): 0, ("ox", "oy", "oz"): 1}
"""Columns of a measured axis -> which axis of the tool it is: x (NP) or y (OP)."""


@dataclass(frozen=True)
class PartialPose(MeasuredPose):
    """Measured points (3, n) mm and unit axes (3, n), external frame; `axis_number` axis of the tool that is.

    The data hold nothing about the rotation of the tool about the measured axis.
    """

    measured: np.ndarray
    axis: np.ndarray
    axis_number: int
    angles = 2

    @classmethod
    def of(cls, recording) -> "PartialPose":
        """From a recording with columns nx ny nz (the tool's x axis) or ox oy oz (its y axis)."""
        names, axis_number = next(
            (names, k) for names, k in AXES.items() if set(names) <= set(recording.columns)
        )
        axis = np.stack([recording.columns[name] for name in names])
        return cls(
            np.ascontiguousarray(recording.points.T),
            axis / np.linalg.norm(axis, axis=0),
            axis_number,
        )

    def at(self, samples: np.ndarray) -> "PartialPose":
        return replace(self, measured=self.measured[:, samples], axis=self.axis[:, samples])

    @property
    def transverse_axes(self) -> np.ndarray:
        """(2, 3, n) unit vectors across the measured axis."""
        least_axis = np.eye(3)[:, np.abs(self.axis).argmin(0)]
        first = cross(self.axis, least_axis)
        first = first / np.linalg.norm(first, axis=0)
        return np.stack([first, cross(self.axis, first)])

    def close(self, frames: Frames, values: np.ndarray, deltas: dict) -> Closure:
        """(5, n): point difference in mm, then the angle between the axes (rad), two components across the measured.

        The logarithm on the unit sphere: its length is the angle from 0 to pi. The sines alone would be
        zero again for an axis that points the other way.
        """
        tool = rotation_matrix(values[3:])
        axes = np.stack(frames.end)
        point = moved_target(frames.point(values[:3]), axes, deltas)
        predicted = add_delta(point, deltas["sensor"]) if "sensor" in deltas else point
        axis = np.einsum("fcn,f->cn", axes, tool[:, self.axis_number])
        transverse = self.transverse_axes

        sines = np.einsum("acn,cn->an", transverse, axis)
        cosine = (self.axis * axis).sum(0)
        is_opposite = (np.abs(sines).max(0) < 1e-12) & (cosine < 0)
        sines[0, is_opposite] = 1e-12  # a rotation by pi about any axis across
        leaning = _logarithm(sines, cosine)

        def lean(rotations):
            moved = cross(rotations, np.broadcast_to(axis, rotations.shape))
            return _logarithm_rows(
                sines,
                cosine,
                np.einsum("acn,kcn->kan", transverse, moved),
                (self.axis * moved).sum(1),
            )

        tool_rows = np.zeros((6, 5, point.shape[1]))
        tool_rows[:3, :3] = axes
        tool_rows[3:, 3:] = lean(np.einsum("fcn,fk->kcn", axes, left_jacobian(values[3:])))
        residual = np.concatenate([predicted - self.measured, leaning])
        return Closure(
            residual,
            point,
            _position_rows,
            tool_rows,
            self.port_rows(axes),
            lambda rotations: _rotation_rows(lean(rotations)),
        )

    def start(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """Base pose (6,) and tool (6,) that fit positions and axes together best.

        The rotation of the tool is the shortest one to the axis: that about the axis is not measured.
        """
        from scipy.spatial.transform import Rotation

        start = self.system(frames).starts()[0]
        axis = start.rotations[1][:, self.axis_number]
        alignment, _ = Rotation.align_vectors(axis[None], np.eye(3)[self.axis_number][None])
        place = start.translations[3:]
        return base_values(start, frames, self.measured), np.concatenate(
            [place, alignment.as_rotvec()]
        )

    def system(self, frames: Frames) -> RotationSystem:
        """The rows of one reflector, and R_b^T n - R_f R_t e = 0 with X_1 = R_b^T and X_2 = R_t."""
        rotations = flange_matrices(frames)
        points = point_system(frames, self.measured, np.zeros(len(rotations), int), 1)
        by_base = kronecker_rows(self.axis).reshape(-1, 3, 9)
        by_tool = np.einsum("nij,k->nijk", rotations, np.eye(3)[self.axis_number]).reshape(-1, 3, 9)
        unit = lever_arm(frames.end_origin) / MODEL_ERROR_MM
        rows = unit * np.concatenate([by_base, -by_tool], 2)
        return points.with_orientations(rows)

    def columns(self, residual: np.ndarray) -> dict[str, np.ndarray]:
        """Columns of samples.csv for what was predicted: the measurement moved by its residual (5, n)."""
        names = next(
            names for names, axis_number in AXES.items() if axis_number == self.axis_number
        )
        angle = np.sqrt((residual[3:] ** 2).sum(0))
        sines = np.sinc(angle / np.pi) * residual[3:]
        axis = np.cos(angle) * self.axis + np.einsum("acn,an->cn", self.transverse_axes, sines)
        columns = dict(zip(("x_mm", "y_mm", "z_mm"), self.measured + residual[:3]))
        return columns | dict(zip(names, axis))


def _logarithm(sines, cosine):
    """(2, n) rad: sines (2, n) of a leaning axis and its cosine (n,), stretched to the length of its angle."""
    return sines * _stretch(sines, cosine)[0]


def _stretch(sines, cosine):
    """(n,) angle over its sine, and (n,) that sine, kept off zero; 1 where the axes agree."""
    sine = np.maximum(np.sqrt((sines**2).sum(0)), 1e-12)
    angle = np.arctan2(sine, cosine)
    return angle / sine, sine


def _logarithm_rows(sines, cosine, sine_rows, cosine_rows):
    """(k, 2, n) change of `_logarithm` with changes (k, 2, n) of the sines and (k, n) of the cosine.

    With s the sine and a = atan2(s, c) the angle: d(a/s) = (c ds - s dc) / s - a ds / s^2, where s ds is the
    scalar product of the sines and their change.
    """
    stretch, sine = _stretch(sines, cosine)
    by_sine = (sines * sine_rows).sum(1) / sine
    change = (cosine * by_sine - sine * cosine_rows - stretch * by_sine) / sine
    return stretch * sine_rows + change[:, None] * sines


def _position_rows(rows):
    return np.concatenate([rows, np.zeros((len(rows), 2, rows.shape[2]))], 1)


def _rotation_rows(rotations):
    return np.concatenate([np.zeros((len(rotations), 3, rotations.shape[2])), rotations], 1)
