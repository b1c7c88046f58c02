"""The turntable of a recording: from images of a board that stands on it, and its part of the JSON contract."""

import numpy as np

from sensors.hand_eye.start import board_poses
from sensors.scanner.calibration import ScannerCalibration
from sensors.scanner.turntable import STEP_ERROR
from sensors.scanner.turntable_calibration import (
    TurntableCalibration,
    calibrate_turntable,
    pose_matrices,
)
from workbench.jobs.sensor import camera as cameras


def turntable_of(camera, calibration: ScannerCalibration, progress) -> TurntableCalibration | None:
    """The turntable on which boards stood, from their corners with the scanner's camera; None without one."""
    views = [view for view in camera.views if "table_deg" in view.row]
    if not views:
        return None
    progress(f"turntable from {len(views)} images")
    known_poses = dict(zip(calibration.placements, pose_matrices(calibration.poses)))
    # a view without a name of its placement has no pose of the scanner's calibration, which is only a start here
    poses = np.array(
        [
            known_poses[view.placement]
            if view.placement in known_poses
            else _pose_of_view(view, camera.board.points, calibration.camera)
            for view in views
        ]
    )
    angles = np.deg2rad([view.row["table_deg"] for view in views])
    known = calibration.camera
    size = len(known.values)
    covariance = camera.covariance[:size, :size]
    return calibrate_turntable(views, camera.board.points, known, poses, angles, covariance)


def turntable_of_images(recording, progress) -> TurntableCalibration | None:
    """The turntable of a recording from its camera calibration alone; None where no board stood on a turntable.

    Raises InputError as `workbench.jobs.sensor.camera.calibrate` and `calibrate_turntable`.
    """
    rows = [row for row in recording.images if row["role"] == "board"]
    if not any(row.get("table_deg") is not None for row in rows):
        return None
    progress("the turntable")
    calibration = cameras.calibrate(recording, "brown", progress).calibration
    views = [view for view in calibration.views if "table_deg" in view.row]
    points = calibration.board.points
    poses = [_pose_of_view(view, points, calibration.camera) for view in views]
    angles = np.deg2rad([view.row["table_deg"] for view in views])
    size = len(calibration.camera.values)
    covariance = calibration.covariance[:size, :size]
    return calibrate_turntable(
        views, calibration.board.points, calibration.camera, np.array(poses), angles, covariance
    )


def _pose_of_view(view, points: np.ndarray, camera) -> np.ndarray:
    """(4, 4) T_camera_board, mm, from the corners of one view alone; points (3, c) mm of the board."""
    return board_poses(points[:, view.index], view.pixels, np.zeros(len(view.index), int), camera)[
        0
    ]


def turntable_json(turntable: TurntableCalibration | None) -> dict | None:
    """Axis, angle law and error of each position of a turntable; None without one."""
    if turntable is None:
        return None
    table, degrees = turntable.table, np.rad2deg
    std = np.sqrt(np.diag(table.covariance))
    rows = zip(
        turntable.images,
        turntable.commanded,
        turntable.measured,
        turntable.sigma,
        turntable.residual,
    )
    return {
        "axis": table.axis.tolist(),
        "point_mm": table.point.tolist(),
        "std_tilt_deg": degrees(std[:2]).tolist(),
        "std_shift_mm": std[2:4].tolist(),
        "gain": table.gain,
        "sigma_deg": float(degrees(table.sigma)),
        "sigma_std_deg": float(degrees(turntable.sigma_std)),
        "before_deg": float(degrees(turntable.before)),
        "after_deg": float(degrees(turntable.after)),
        "terms": [
            {
                "effect": STEP_ERROR,
                "name": term.name,
                "order": term.order,
                "values": list(term.values),
                "probability": term.probability,
                "retained": term.retained,
            }
            for term in turntable.terms
        ],
        "positions": [
            {
                "image": name,
                "commanded_deg": float(degrees(commanded)),
                "measured_deg": float(degrees(measured)),
                "std_deg": float(degrees(sigma)),
                "residual_deg": float(degrees(remainder)),
            }
            for name, commanded, measured, sigma, remainder in rows
        ],
    }
