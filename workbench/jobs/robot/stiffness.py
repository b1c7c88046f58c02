"""Cartesian stiffness of a calibrated arm: what a wrench at the tool moves it by, and which part deflects.

Virtual joint method: every compliant joint, bearing, link and the pedestal is a torsion spring about one or two axes.
A unit rotation about axis i through point o_i moves the tool by the twist t_i = (a_i x (p - o_i), a_i); a wrench w puts
the torque t_i . w on it. The Cartesian compliance is C = sum_i c_i t_i t_i^T, the stiffness its inverse
(Salisbury, IEEE CDC 1980; Klimchik et al., Mech. Mach. Theory 79, 2014).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from robot_model.chain import Frames, forward
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.core.text.csv_text import csv_text
from workbench.files.exports.mdh import calibrated_geometry
from workbench.files.exports.mjcf import Compliances, compliances_of
from workbench.files.solution_file import CalibratedArm

ELEMENTS = ("joint", "bearing", "link", "pedestal")
MODELS = {
    "rigid": (),
    "joints": ("joint",),
    "joints and bearings": ("joint", "bearing"),
    "joints, bearings, links and pedestal": ELEMENTS,
}
"""Models that are compared: name -> the parts that deflect."""
_FORCE, _MOMENT = slice(0, 3), slice(3, 6)
_RIGID = 1e-12  # share of the largest eigenvalue below which a direction does not deflect


@dataclass(frozen=True)
class CartesianStiffness:
    """Compliance of the tool point at n configurations, in the robot's root frame.

    `compliance` part -> (n, 6, 6): twist (mm, rad) per wrench (N, N m); rows and columns are force and translation,
    then moment and rotation. `points` (n, 3) mm of the tool point.
    """

    compliance: Mapping[str, np.ndarray]
    points: np.ndarray

    @property
    def total(self) -> np.ndarray:
        """(n, 6, 6) of all parts together."""
        return sum(self.compliance.values())

    @property
    def stiffness(self) -> np.ndarray:
        """(n, 6, 6) wrench (N, N m) per twist (mm, rad); infinite along what does not deflect, given as nan."""
        # in metres, so that translations and rotations are of one size
        scale = np.array([1e-3, 1e-3, 1e-3, 1, 1, 1])
        balanced = self.total * scale[:, None]
        values = np.linalg.eigvalsh(balanced)
        is_rigid = values[:, 0] <= _RIGID * values[:, -1]
        inverse = np.full_like(balanced, np.nan)
        inverse[~is_rigid] = np.linalg.inv(balanced[~is_rigid])
        return inverse * scale

    def deflection(self, wrench: np.ndarray) -> dict[str, np.ndarray]:
        """Part -> (n, 6) mm and rad that a wrench (6,) N, N m at the tool point, in the root frame, makes."""
        return {
            part: compliance @ np.asarray(wrench, float)
            for part, compliance in self.compliance.items()
        }

    def translational(self) -> np.ndarray:
        """(n, 3) mm/N: least, middle and largest translation per force without a moment, over all directions.

        A compliance matrix has no negative eigenvalue: what rounding leaves below zero is zero.
        """
        return np.maximum(np.linalg.eigvalsh(self.total[:, _FORCE, _FORCE]), 0.0)

    def models(self, wrench=None) -> dict[str, np.ndarray]:
        """Model of `MODELS` -> (n,) mm: translation under a wrench, or the largest per newton of force."""
        models = {}
        for name, elements in MODELS.items():
            total = sum((self.compliance[part] for part in elements), np.zeros_like(self.total))
            if wrench is None:
                models[name] = np.linalg.eigvalsh(total[:, _FORCE, _FORCE])[:, -1]
            else:
                moved = total @ np.asarray(wrench, float)
                models[name] = np.linalg.norm(moved[:, _FORCE], axis=1)
        return models


def cartesian_stiffness(
    arm: CalibratedArm, readings: np.ndarray, tool_point=(0.0, 0.0, 0.0)
) -> CartesianStiffness:
    """Cartesian stiffness of a calibrated arm at readings (n, R) rad, mm.

    tool_point (3,) mm in the flange frame: where the wrench acts. Raises InputError for an arm without compliance.
    """
    found = compliances_of(arm)
    if not (found.joint or found.bearing or found.link or any(found.pedestal)):
        raise InputError(
            "the calibration holds no compliance of a joint, bearing, link or pedestal, so that nothing deflects; "
            "calibrate with a plan that estimates compliances, or diagnose a recording with loads"
        )
    variables = arm.robot.mixing @ np.asarray(readings, float).T
    frames = forward(arm.robot, variables, calibrated_geometry(arm), links=True)
    point = frames.point(np.asarray(tool_point, float))
    by_element = {part: np.zeros((variables.shape[1], 6, 6)) for part in ELEMENTS}
    for number, compliance in found.joint.items():
        by_element["joint"] += compliance * _outer(_drive_twist(arm.robot, frames, number, point))
    for part, compliance, axis, origin in _springs(found, frames):
        by_element[part] += compliance * _outer(_twist(axis, point - origin))
    return CartesianStiffness(by_element, point.T)


def _drive_twist(robot: Robot, frames: Frames, number: int, point: np.ndarray) -> np.ndarray:
    """(6, n) twist at a point (3, n) per unit of a drive's motion; 0 of a slide, which has no rotation."""
    if robot.coupling is None:
        moves = np.eye(robot.joints)
    else:
        moves = robot.coupling
    twist = np.zeros((6, point.shape[1]))
    for joint in np.flatnonzero(moves[:, number - 1]):
        if not robot.prismatic[joint]:
            turn = _twist(frames.z[joint], point - frames.z_origin[joint])
            twist += moves[joint, number - 1] * turn
    return twist


def _springs(found: Compliances, frames: Frames):
    """(part, rad/(N m), axis (3, n), point on it (3, n)) of every spring but those of the drives."""
    for number, compliance in found.bearing.items():
        for axis in _transverse_directions(frames.z[number - 1], frames.x[number - 1]):
            yield "bearing", compliance, axis, frames.z_origin[number - 1]
    for number, compliance in found.link.items():
        link_direction = _link_directions(frames, number)
        for axis in _transverse_directions(
            link_direction, frames.link[number][0], frames.link[number][1]
        ):
            yield "link", compliance, axis, frames.pivot[number]
    for axis, compliance in zip(frames.link[0], found.pedestal):
        yield "pedestal", compliance, axis, frames.pivot[0]


def _link_directions(frames: Frames, number: int) -> np.ndarray:
    """(3, n) unit vector along a link; that of its joint's axis where it has no length."""
    line = frames.link_vector(number)
    length = np.sqrt((line**2).sum(0))
    return np.where(length > 1e-6, line / np.maximum(length, 1e-6), frames.z[number - 1])


def _transverse_directions(
    direction: np.ndarray, *hints: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Two unit axes (3, n) across `direction`: the hint that is farthest from it, cleared of it, and their product."""
    shares = np.stack([np.abs((hint * direction).sum(0)) for hint in hints])
    if len(hints) > 1:
        hint = np.choose(np.argmin(shares, 0), hints)
    else:
        hint = hints[0]
    first = hint - direction * (hint * direction).sum(0)
    first = first / np.sqrt((first**2).sum(0))
    return first, np.cross(direction, first, axis=0)


def _twist(axis: np.ndarray, lever: np.ndarray) -> np.ndarray:
    """(6, n) mm and rad per radian about an axis (3, n), at a lever (3, n) mm from it."""
    return np.concatenate([np.cross(axis, lever, axis=0), axis])


def _outer(twist: np.ndarray) -> np.ndarray:
    """(n, 6, 6) twist (6, n) in mm and rad per rad, times the torque in N m per N and N m of the same lever."""
    torque = twist * np.array([1e-3] * 3 + [1.0] * 3)[:, None]
    return np.einsum("in,jn->nij", twist, torque)


def stiffness_columns(found: CartesianStiffness, wrench) -> dict[str, np.ndarray]:
    """Columns of stiffness.csv: tool point, compliance along the axes and its extremes, deflection by part and axis."""
    columns = {f"{axis}_mm": row for axis, row in zip("xyz", found.points.T)}
    for k, axis in enumerate("xyz"):
        columns[f"compliance_{axis}_mm_per_n"] = found.total[:, k, k]
    smallest, _, largest = found.translational().T
    columns |= {"compliance_least_mm_per_n": smallest, "compliance_largest_mm_per_n": largest}
    if wrench is not None:
        moved = found.deflection(wrench)
        for part in ELEMENTS:
            columns[f"deflection_{part}_mm"] = np.linalg.norm(moved[part][:, _FORCE], axis=1)
        total = sum(moved.values())
        for axis, row in zip("xyz", total.T):
            columns[f"deflection_{axis}_mm"] = row
        columns["deflection_mm"] = np.linalg.norm(total[:, _FORCE], axis=1)
        columns["deflection_deg"] = np.rad2deg(np.linalg.norm(total[:, _MOMENT], axis=1))
    return columns


def model_columns(found: CartesianStiffness, wrench) -> dict[str, np.ndarray]:
    """Columns of models.csv: the translation of each model under a wrench, or its largest per newton of force."""
    unit = "mm_per_n" if wrench is None else "mm"
    names = {name: name.replace(", ", "_").replace(" ", "_") for name in MODELS}
    return {f"{names[name]}_{unit}": values for name, values in found.models(wrench).items()}


def save(
    found: CartesianStiffness,
    wrench,
    folder: Path,
    readings: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write stiffness.csv, models.csv, compliance.npy and stiffness.npy (n, 6, 6), map.vtk, and map and models as PDF
    and SVG.

    readings: joint columns (n,) in file units, which the tables repeat.
    """
    columns = stiffness_columns(found, wrench)
    readings = dict(readings or {})
    tables = {"stiffness": columns, "models": model_columns(found, wrench)}
    for name, table in tables.items():
        table_columns = readings | table
        lines = [[f"{value:.9g}" for value in row] for row in zip(*table_columns.values())]
        (folder / f"{name}.csv").write_text(csv_text(list(table_columns), lines), encoding="utf-8")
    np.save(folder / "compliance.npy", found.total)
    np.save(folder / "stiffness.npy", found.stiffness)
    (folder / "map.vtk").write_text(_vtk(found.points, columns), encoding="utf-8")
    figures = {"map": map_figure(found, wrench), "models": models_figure(found, wrench)}
    for name, figure in figures.items():
        for suffix in ("pdf", "svg"):
            figure.savefig(folder / f"{name}.{suffix}")


def _vtk(points: np.ndarray, columns: Mapping[str, np.ndarray]) -> str:
    """Legacy VTK text: the tool points as vertices, every column as a scalar field, the deflection also as a vector."""
    n = len(points)
    lines = ["# vtk DataFile Version 3.0", "Cartesian compliance", "ASCII", "DATASET POLYDATA"]
    lines += [f"POINTS {n} double", *(" ".join(f"{v:.9g}" for v in row) for row in points)]
    lines += [f"VERTICES {n} {2 * n}", *(f"1 {k}" for k in range(n)), f"POINT_DATA {n}"]
    for name, values in columns.items():
        lines += [f"SCALARS {name} double 1", "LOOKUP_TABLE default"]
        lines += [f"{value:.9g}" for value in values]
    if "deflection_x_mm" in columns:
        moved = zip(*(columns[f"deflection_{axis}_mm"] for axis in "xyz"))
        lines += ["VECTORS deflection_vector_mm double"]
        lines += [" ".join(f"{v:.9g}" for v in row) for row in moved]
    return "\n".join(lines) + "\n"


def map_figure(found: CartesianStiffness, wrench):
    """A matplotlib figure: largest translational compliance, or the deflection under a wrench, over the workspace."""
    from matplotlib.figure import Figure

    columns = stiffness_columns(found, wrench)
    name, label = (
        ("compliance_largest_mm_per_n", "largest translational compliance (mm/N)")
        if wrench is None
        else ("deflection_mm", "deflection under the wrench (mm)")
    )
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    panels = figure.subplots(1, 2)
    for axes, (first, second) in zip(panels, ((0, 1), (0, 2))):
        shown = axes.scatter(
            found.points[:, first], found.points[:, second], c=columns[name], cmap="viridis"
        )
        axes.set(xlabel=f"{'xyz'[first]} (mm)", ylabel=f"{'xyz'[second]} (mm)", aspect="equal")
    figure.colorbar(shown, ax=panels, label=label)
    return figure


def models_figure(found: CartesianStiffness, wrench):
    """A matplotlib figure: one map a model, rigid to all parts, on one colour scale, and their distributions."""
    from matplotlib.figure import Figure

    models = found.models(wrench)
    label = (
        "largest translational compliance (mm/N)"
        if wrench is None
        else "deflection under the wrench (mm)"
    )
    figure = Figure(figsize=(4.2 * len(models), 7.6), layout="constrained")
    maps, lower = figure.subfigures(2, 1)
    panels = maps.subplots(1, len(models), sharex=True, sharey=True)
    top = max(float(values.max()) for values in models.values())
    for axes, (name, values) in zip(panels, models.items()):
        shown = axes.scatter(*found.points.T[[0, 2]], c=values, vmin=0, vmax=max(top, 1e-12))
        axes.set(xlabel="x (mm)", title=name, aspect="equal")
        axes.title.set_size(9)
    panels[0].set(ylabel="z (mm)")
    maps.colorbar(shown, ax=panels, label=label)
    axes = lower.subplots()
    for name, values in models.items():
        axes.ecdf(values, label=name)
    axes.set(xlabel=label, ylabel="share of poses (1)")
    axes.legend(frameon=False)
    return figure


__all__ = ["MODELS", "CartesianStiffness", "cartesian_stiffness", "save", "stiffness_columns"]
