"""Poses of arm, sensor and instrument: forward kinematics of the nominal arm for the rows that are drawn."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from robot_model.chain import forward
from workbench.app.data.opened import Opened
from workbench.core.rigid import rotation_matrix, transform

SENSOR_DEPTH_MM, AXIS_MM = 130.0, 200.0
"""Drawn depth of the sensor's field, and drawn length of the axes of the instrument."""


@dataclass(frozen=True)
class ArmPose:
    """The nominal arm at one sample, mm, robot's root frame.

    `links` (3, J + 2): root, joint origins, flange; `flange` (4, 4) T_root_flange; `sensor` (4, 4) T_root_sensor
    or None; `targets` (3, k): reflectors on the tool, as the calibration places them.
    """

    links: np.ndarray
    flange: np.ndarray
    sensor: np.ndarray | None
    targets: np.ndarray


def has_arm(opened: Opened) -> bool:
    """Whether there are joint readings and a robot to draw."""
    return opened.robot is not None and opened.joints.shape[1] > 0


def arm_pose(opened: Opened, row: int) -> ArmPose:
    """The arm at row `row` of `opened.samples`."""
    variables = opened.robot.mixing @ opened.joints[row : row + 1].T
    frames = forward(opened.robot, variables, links=True)
    links = np.vstack(
        [frames.pivot[:1, :, 0], frames.origin[:, :, 0], frames.end_origin[None, :, 0]]
    ).T
    flange = transform(np.stack(frames.end, -1)[:, 0], frames.end_origin[:, 0])
    pose = _values(opened, "sensor")
    sensor = None if pose is None else flange @ transform(rotation_matrix(pose[3:]), pose[:3])
    targets = _reflectors(opened)
    return ArmPose(links, flange, sensor, flange[:3, :3] @ targets + flange[:3, 3:])


def flange_points(opened: Opened, rows: np.ndarray) -> np.ndarray:
    """(3, k) mm: flange of the nominal arm at some rows of `opened.samples`."""
    variables = opened.robot.mixing @ opened.joints[rows].T
    return forward(opened.robot, variables).end_origin


def outer_frame(opened: Opened) -> np.ndarray | None:
    """(4, 4) T_root_outer: the instrument, or the artefact that the sensor measures; None before a calibration."""
    pose = _values(opened, "base")
    if pose is None:
        return None
    rotation = rotation_matrix(pose[3:])
    return transform(rotation.T, -rotation.T @ pose[:3])


_LOOKED_AT = 200
_MARGIN = 0.04


@lru_cache(maxsize=4)
def reach(opened: Opened, with_outer: bool) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest (3,) mm of all that is drawn of the arm, whichever sample is shown.

    with_outer: also the instrument or the balls. Arm, sensor and targets of evenly spread samples are looked at.
    """
    rows = np.unique(np.linspace(0, max(len(opened.rows) - 1, 0), _LOOKED_AT).astype(int))
    seen = [_outline(arm_pose(opened, int(opened.rows[row]))) for row in rows]
    if opened.residuals is not None and opened.residuals.points is not None:
        seen.append(opened.residuals.points)
    outer = outer_frame(opened) if with_outer else None
    if outer is not None:
        seen.append(_outer_outline(opened, outer))
    points = np.concatenate(seen, axis=1)
    low = np.nanmin(points, axis=1)
    high = np.nanmax(points, axis=1)
    margin = _MARGIN * float(np.linalg.norm(high - low))
    return low - margin, high + margin


def _outline(pose: ArmPose) -> np.ndarray:
    """(3, k) mm: links, targets and the end of the sensor's field."""
    point_sets = [pose.links, pose.targets]
    if pose.sensor is not None:
        point_sets.append((pose.sensor[:3, 3] + SENSOR_DEPTH_MM * pose.sensor[:3, 2])[:, None])
    return np.concatenate(point_sets, axis=1)


def _outer_outline(opened: Opened, frame: np.ndarray) -> np.ndarray:
    """(3, k) mm: balls of the artefact, or ends of the axes of the instrument."""
    if opened.samples.balls:
        places = np.array([ball[:3] for ball in opened.samples.balls.values()]).T
    else:
        places = np.hstack([np.zeros((3, 1)), AXIS_MM * np.eye(3)])
    return frame[:3, :3] @ places + frame[:3, 3:]


def joint_coverage(opened: Opened) -> list[dict]:
    """One row a joint: `label`, `unit`, `low` and `high` reading, `limits` (nan where unknown), `edges`, `counts`.

    Readings in deg (mm of a slide); counts over 36 bins from the lower to the higher limit.
    """
    from datasets.samples.columns import joint_columns

    rows = []
    for k, name in enumerate(joint_columns(opened.samples.columns)):
        values = opened.samples.columns[name]
        unit = "mm" if name.endswith("_mm") else "deg"
        scale = 1.0 if unit == "mm" else 180 / np.pi
        limits = opened.robot.limits[k] * scale if opened.robot is not None else np.full(2, np.nan)
        low = float(values.min())
        high = float(values.max())
        ends = [
            limits[0] if np.isfinite(limits[0]) else low,
            limits[1] if np.isfinite(limits[1]) else high,
        ]
        edges = np.linspace(min(ends[0], low), max(ends[1], high, ends[0] + 1e-6), 37)
        counts = np.histogram(values, edges)[0]
        label = f"joint {name[1:].partition('_')[0]}"
        rows.append(
            {
                "label": label,
                "unit": unit,
                "low": low,
                "high": high,
                "limits": limits,
                "edges": edges,
                "counts": counts,
            }
        )
    return rows


def _values(opened: Opened, where: str) -> np.ndarray | None:
    """(6,) x, y, z, rx, ry, rz of a frame of the solution; None where it has none."""
    names = [f"{where}.{part}" for part in ("x", "y", "z", "rx", "ry", "rz")]
    if not all(name in opened.values for name in names):
        return None
    return np.array([opened.values[name] for name in names])


def _reflectors(opened: Opened) -> np.ndarray:
    """(3, k) mm, flange frame: reflectors of the solution, in order; one at the flange where there are none."""
    found = []
    for number in range(1, 1000):
        names = [f"tool.reflector{number}_{axis}" for axis in "xyz"]
        if not all(name in opened.values for name in names):
            break
        found.append([opened.values[name] for name in names])
    return np.array(found).T if found else np.zeros((3, 0))
