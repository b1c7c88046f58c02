"""Units of targets: radians under the header of degrees, metres or inches under that of millimetres.

An inverse model finds readings for wrong units, too: an arm folds itself around its root. So targets are compared with
where the arm was when it was recorded, as they stand and after a change of the unit.
"""

import numpy as np

from datasets.errors import complaint
from robot_model.state import reading_names, sliding
from workbench.files.solution_file import CalibratedArm
from workbench.jobs.robot.compensation.compensate import nominal_poses

_LENGTH_UNITS = {"metres": 1000.0, "inches": 25.4}
_DRAWN = 2000  # readings over the recorded ranges, whose flange positions are compared
_SLACK = 0.5  # share of a distance or of a range by which targets may be outside what was recorded
# an angle in radians is at most one revolution; a joint whose angle is below the second limit (deg) tells nothing
_LARGEST_RAD, _LEAST_DEG = 2 * np.pi, 0.1
_WIDE = np.deg2rad(
    60
)  # recorded range of a joint that is hardly kept within some degrees of zero by chance


def check_units(arm: CalibratedArm, programme) -> None:
    """InputError where all targets are far from what was recorded, and another unit brings them there.

    programme: `workbench.files.targets.Programme`. A solution without recorded ranges is not compared.
    """
    if arm.fitted_range is None:
        return
    is_joint = programme.is_joint
    if programme.poses is None or (is_joint is not None and is_joint.any()):
        rows = slice(None) if programme.poses is None else is_joint
        _check_angles(arm, programme, programme.readings[rows])
    if programme.poses is not None:
        rows = slice(None) if is_joint is None else ~is_joint
        _check_positions(arm, programme, programme.poses[rows, :3, 3])


def _check_angles(arm: CalibratedArm, programme, readings: np.ndarray) -> None:
    """readings (n, R) rad, mm: not radians that are read as degrees."""
    low, high = _recorded_ends(arm)
    turns = ~sliding(arm.robot) & np.isfinite(low)
    readings = readings[:, turns]
    low = low[turns]
    high = high[turns]
    if not readings.size:
        return
    slack = _SLACK * (high - low)
    as_radians = np.rad2deg(readings)
    is_explained = ((as_radians >= low - slack) & (as_radians <= high + slack)).all()
    # a joint at zero, as in a home position, says nothing: it is zero in both units
    is_outside = ((readings < low) | (readings > high)).all(0)
    is_inside = ((as_radians >= low) & (as_radians <= high)).all(0)
    if is_explained and (
        (is_outside & is_inside).any() or _are_all_near_zero(readings, high - low)
    ):
        largest_deg = np.rad2deg(np.abs(readings).max())
        raise complaint(
            programme.table.called,
            "joint angles in deg, near those of the recording",
            f"none beyond {largest_deg:.3g} deg, and all in the recorded ranges if they are radians",
            "multiply the angles by 57.29578, or add --force where the targets are right",
        )


def _are_all_near_zero(readings: np.ndarray, extent: np.ndarray) -> bool:
    """Whether no angle (n, R) exceeds 6.3 deg, although most joints move and were recorded over wide ranges (R,)."""
    largest = np.rad2deg(np.abs(readings).max(0))
    moves = (largest > _LEAST_DEG) & (extent > _WIDE)
    return bool((largest <= _LARGEST_RAD).all() and moves.mean() > 0.5)


def _check_positions(arm: CalibratedArm, programme, positions: np.ndarray) -> None:
    """positions (n, 3) mm, root frame: not metres or inches that are read as millimetres."""
    nearest, farthest = _recorded_distances(arm)
    distance = np.linalg.norm(positions, axis=1)
    if not distance.size or distance.max() > _SLACK * nearest:
        return
    for unit, factor in _LENGTH_UNITS.items():
        is_near = factor * distance.min() > _SLACK * nearest
        if is_near and factor * distance.max() < (1 + _SLACK) * farthest:
            raise complaint(
                programme.table.called,
                "positions in mm, as far from the robot's root as those of the recording "
                f"({nearest:.3g} to {farthest:.3g} mm)",
                f"none beyond {distance.max():.3g} mm, and all in that range if they are {unit}",
                f"multiply the positions by {factor:g}, or add --force where the targets are right",
            )


def _recorded_ends(arm: CalibratedArm) -> tuple[np.ndarray, np.ndarray]:
    """(R,) lowest and (R,) highest recorded reading, rad or mm; nan where it is not known."""
    ends = []
    for name in reading_names(arm.robot):
        pair = arm.fitted_range.get(name, (np.nan, np.nan))
        ends.append(np.array(pair) if name.endswith("mm") else np.deg2rad(pair))
    return tuple(np.array(ends, float).T)


def _recorded_distances(arm: CalibratedArm) -> tuple[float, float]:
    """Least and largest distance (mm) of the nominal flange from the root over the recorded ranges of the joints."""
    low, high = np.nan_to_num(_recorded_ends(arm))
    readings = np.random.default_rng(0).uniform(low, high, (_DRAWN, len(low)))
    distance = np.linalg.norm(nominal_poses(arm.robot, readings)[:, :3, 3], axis=1)
    return float(distance.min()), float(distance.max())
