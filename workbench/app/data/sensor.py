"""The calibrated sensor of a run, its clouds and balls, and how far corners lie from where the camera expects them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from workbench.app.data.decimate import thinned
from workbench.app.data.opened import Opened
from workbench.app.security import resolve_inside
from workbench.core.errors import InputError

SCANNER = "scanner.toml"
CAMERA = "camera.toml"
_MOST_CLOUD = 8000
_SHELL_MM = 1.0


def camera_of(opened: Opened):
    """The calibrated camera of the run, that of a hand-eye calibration too; None where it has none."""
    path = _file_of(opened, SCANNER) or _file_of(opened, CAMERA)
    if path is None:
        return _camera_in_answer(opened)
    from workbench.jobs.sensor.camera import read

    return read(path)


def _camera_in_answer(opened: Opened):
    """The camera that a run without a file of it states in its answer; None where it states none."""
    keys = (opened.answer or {}).get("camera")
    if not isinstance(keys, Mapping) or "fx_px" not in keys:
        return None
    from sensors.camera.model import camera_from_keys

    return camera_from_keys(keys, f"{opened.folder}/answer.json")


def scanner_of(opened: Opened):
    """The calibrated scanner of the run; None where it has none."""
    path = _file_of(opened, SCANNER)
    if path is None:
        return None
    from workbench.jobs.sensor.scanner import read

    return read(path)


def _file_of(opened: Opened, name: str) -> Path | None:
    return None if opened.folder is None else resolve_inside(opened.folder, name)


def scans_of(opened: Opened) -> list[Mapping]:
    """Rows of the scans in the run's answer; [] where there are none."""
    answer = opened.answer or {}
    inner = answer.get("sensor", answer)
    found = inner.get("scans", []) if isinstance(inner, Mapping) else []
    return found if isinstance(found, list) else []


@dataclass(frozen=True)
class Cloud:
    """Points (3, n) mm in the sensor frame, thinned; `deviation` (n,) mm from the nearest fitted ball, nan off it."""

    points: np.ndarray
    deviation: np.ndarray
    balls: tuple[Mapping, ...]
    total: int


def cloud_of(opened: Opened, place: int) -> Cloud | None:
    """The cloud of the scan at `place` with its fitted balls; None where the run holds none. Raises InputError."""
    scans = scans_of(opened)
    if not 0 <= place < len(scans) or not scans[place].get("cloud"):
        return None
    path = resolve_inside(opened.folder, f"clouds/{Path(scans[place]['cloud']).name}")
    if path is None:
        raise InputError(
            f"{opened.folder}/clouds: expected the cloud of scan {scans[place]['scan']}, found none; scan again"
        )
    import pyvista

    points = np.asarray(pyvista.read(path).points, float).T
    rows = thinned(points.shape[1], _MOST_CLOUD)
    balls = tuple(scans[place]["balls"])
    return Cloud(points[:, rows], _deviation(points[:, rows], balls), balls, points.shape[1])


def _deviation(points: np.ndarray, balls) -> np.ndarray:
    """(n,) mm: signed distance from the surface of the nearest ball, nan farther off than a millimetre."""
    nearest = np.full(points.shape[1], np.nan)
    for ball in balls:
        distances = _from_surface(points, ball)
        closer = (np.abs(distances) < _SHELL_MM) & ~(np.abs(nearest) <= np.abs(distances))
        nearest = np.where(closer, distances, nearest)
    return nearest


def _from_surface(points: np.ndarray, ball) -> np.ndarray:
    """(n,) mm: signed distance of points (3, n) from the surface of one ball."""
    centre = np.array([[ball[f"{axis}_mm"]] for axis in "xyz"])
    return np.sqrt(((points - centre) ** 2).sum(0)) - ball["radius_mm"]


def reprojection(opened: Opened, corners: np.ndarray, index: np.ndarray) -> np.ndarray | None:
    """(2, k) px: predicted minus detected corners of one board image, its pose fitted to this image alone.

    corners (2, k) px; index (k,) which of the board's corners. None without a calibrated camera or a pose.
    """
    import cv2

    from sensors.boards.board import Board

    camera = camera_of(opened)
    if camera is None or opened.recording.board is None or corners.shape[1] < 6:
        return None
    board = Board.of(
        {key: value for key, value in opened.recording.board.items() if key != "fixed_to"}
    )
    places = np.asarray(board.points)
    places = (places.T if places.shape[0] == 3 else places)[index]
    solved, rotation, shift = cv2.solvePnP(places, *camera.pnp_view(corners))
    if not solved:
        return None
    return camera.project(cv2.Rodrigues(rotation)[0] @ places.T + shift) - corners
