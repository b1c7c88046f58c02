"""A whole recording of rendered images, as a laboratory would have made it, and its ground truth."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sensors.camera.model import camera_keys
from sensors.rendering.places import artefact_poses, board_poses
from sensors.rendering.ports import Moment
from sensors.rendering.render import render_board, render_scan
from sensors.rendering.scene import Scene
from sensors.rendering.surfaces import (
    BallSurface,
    BoardSurface,
    Gloss,
    MeshSurface,
    Surface,
    true_balls,
)
from workbench.core.errors import InputError
from workbench.core.rigid import inverse, rotation_matrix, rotation_vector
from workbench.core.text.cloud_headers import ply_problem
from workbench.core.text.csv_text import write_rows

_ROLES = ("board", "board-laser", "scan")
_EXPOSURE_S = 1.0  # between two images while nothing sweeps


@dataclass(frozen=True)
class Stations:
    """Flange poses of a scan series: one row of samples.csv a scan.

    `poses` (n, 4, 4) T_artefact_sensor as they truly were; `columns` of samples.csv, each (n,), with
    `sample`; `robot` the keys of robot.toml; `section` of recording.toml's [robot], its file if empty.
    `boards` (g, 4, 4) T_camera_board of board poses that the arm held, taken at the samples `board_samples` (g,).
    `rows` (n) and `board_rows` (g): cells of images.csv of each station and each board, instead of these numbers:
    several stations of one `scan` make a joined scan.
    """

    poses: np.ndarray
    columns: Mapping[str, np.ndarray]
    robot: Mapping = field(default_factory=dict)
    section: Mapping = field(default_factory=dict)
    boards: np.ndarray | None = None
    board_samples: np.ndarray | None = None
    rows: tuple[Mapping, ...] | None = None
    board_rows: tuple[Mapping, ...] | None = None


@dataclass(frozen=True)
class Made:
    """Written rows of images.csv, and the truth behind them (plain numbers and lists)."""

    images: tuple[Mapping, ...]
    truth: Mapping


@dataclass(frozen=True)
class _Take:
    """Images of one static pose: one of the board, or a sweep with one a step.

    `place` is its number from 1, `row` what all its images have in common in images.csv.
    """

    role: str
    place: int
    surfaces: tuple[Surface, ...]
    covariates: Mapping[str, float]
    row: Mapping[str, object]
    seconds: float = _EXPOSURE_S


def make_recording(
    scene: Scene,
    folder: Path,
    progress: Callable[[int, int], None] | None = None,
    stations: Stations | None = None,
    truth: Path | None = None,
) -> Made:
    """Render the scene into `folder`, which then is a recording of kind scan-images or board-images.

    progress: called with images done and in all; stations: of a scene with an arm, whose scans
    these are then; truth: TOML file to write the truth to. Raises InputError for a scene that cannot be.
    """
    folder = Path(folder)
    with _writing(folder):
        (folder / "images").mkdir(parents=True, exist_ok=True)
    boards, artefacts = _places(scene, stations)
    takes = list(_takes(scene, boards, artefacts, stations))
    sweeps = len(scene.instrument.steps)
    total = sum(1 if take.role == "board" else sweeps for take in takes)
    rows = []
    for take in takes:
        for row in _images(scene, take, folder):
            rows.append(row)
            if progress:
                progress(len(rows), total)
    recording = Made(tuple(rows), _truth(scene, boards, artefacts, takes))
    _write(scene, folder, recording, stations)
    if truth is not None:
        _write_toml(Path(truth), recording.truth)
    return recording


def _places(scene: Scene, stations: Stations | None) -> tuple[np.ndarray, np.ndarray]:
    """Poses (G, 6) of the board and of the artefact in the camera frame."""
    if stations is None:
        return _drawn_boards(scene), _drawn_artefacts(scene)
    boards = _drawn_boards(scene) if stations.boards is None else _six(stations.boards)
    return boards, _six(inverse(np.asarray(stations.poses)))


def _drawn_boards(scene: Scene) -> np.ndarray:
    rng = np.random.default_rng((scene.seed, 1))
    return board_poses(scene.placements, scene.board.pattern, scene.sees, rng)


def _drawn_artefacts(scene: Scene) -> np.ndarray:
    rng = np.random.default_rng((scene.seed, 2))
    centres = np.array(scene.balls)[:, :3].T if scene.balls else np.zeros((3, 1))
    return artefact_poses(scene.scans, centres, scene.sees, rng)


def _six(poses: np.ndarray) -> np.ndarray:
    return np.concatenate([poses[:, :3, 3], rotation_vector(poses[:, :3, :3])], axis=1)


def _takes(scene, boards, artefacts, stations) -> Iterator[_Take]:
    """Everything in the order in which it was taken, with the clock running."""
    rng = np.random.default_rng((scene.seed, 3))
    clock = 0.0
    laser_placements = scene.placements.laser
    laser = len(boards) if laser_placements is None else min(laser_placements, len(boards))
    laser = laser if len(scene.instrument.steps) else 0
    order = [("board", k) for k in range(len(boards))]
    order += [("board-laser", k) for k in range(laser)] + [
        ("scan", k) for k in range(len(artefacts))
    ]
    order.sort(key=lambda item: (item[0] == "scan", item[1], item[0]))
    for count, (role, k) in enumerate(order):
        covariates, seconds = _covariates(
            scene, role, k, clock, count / max(len(order) - 1, 1), rng
        )
        moment = Moment(scene.causes, covariates)
        if role == "scan":
            surfaces = _artefact(scene, artefacts[k], moment)
            row = {"scan": k + 1}
            is_numbered = stations is not None and stations.rows is None
            number = stations.columns["sample"][k] if is_numbered else None
        else:
            surfaces = (BoardSurface(scene.board.pattern, boards[k], scene.sees, moment),)
            row = {"placement": k + 1}
            columns = stations is not None and stations.board_samples is not None
            number = stations.board_samples[k] if columns else None
        if number is not None:
            row["sample"] = int(number)
        row |= _own_cells(stations, role, k)
        yield _Take(role, k + 1, surfaces, covariates, row, seconds)
        clock += seconds * (1 if role == "board" else len(scene.instrument.steps))


def _own_cells(stations: Stations | None, role: str, place: int) -> Mapping:
    """Cells of images.csv that the stations state for one static pose."""
    rows = None
    if stations is not None:
        rows = stations.rows if role == "scan" else stations.board_rows
    return {} if rows is None else rows[place]


def _covariates(scene, role, place, clock, share, rng) -> tuple[dict[str, float], float]:
    """Values of the columns in the first image, and seconds from one image to the next."""
    found = {"time_s": clock}
    seconds = _EXPOSURE_S
    if scene.temperature_c:
        first, last = scene.temperature_c
        found["temperature_c"] = round(first + share * (last - first), 3)
    if scene.mirror and role != "board":
        keys = scene.mirror
        found["sweep"] = -1.0 if keys.both_ways and place % 2 else 1.0
        speed = round(rng.uniform(*keys.speed_deg_s), 4)
        found["mirror_speed_deg_s"] = found["sweep"] * speed
        seconds = abs(keys.last_deg - keys.first_deg) / max(keys.steps - 1, 1) / speed
    return found, seconds


def _artefact(scene, pose, moment) -> tuple[Surface, ...]:
    """Balls in view and mesh, in the camera frame."""
    rotation = rotation_matrix(pose[3:])
    camera = scene.sees
    surfaces = []
    if scene.balls:
        table = np.array(scene.balls).T
        centres, radii = true_balls(table[:3], table[3], camera, moment)
        centres = rotation @ centres + pose[:3, None]
        gloss = Gloss(scene.ball_gloss, scene.ball_gloss_exponent)
        surfaces = [
            BallSurface(centres[:, k], radii[k], k + 1, scene.ball_white, gloss)
            for k in range(len(radii))
            if _in_view(centres[:, k], radii[k], camera)
        ]
    if scene.mesh:
        vertices, triangles = _mesh(scene.mesh.file)
        surfaces.append(MeshSurface(vertices @ rotation.T + pose[:3], triangles, scene.mesh.white))
    return tuple(surfaces)


def _in_view(centre, radius, camera) -> bool:
    distance = np.linalg.norm(centre)
    if distance <= radius:
        return True
    widest = _half_field(camera) + np.arcsin(radius / distance)
    return bool(centre[2] / distance > np.cos(min(widest, np.pi)))


def _half_field(camera) -> float:
    """rad, from the optical axis to the farthest corner of the image."""
    last_pixel = np.array(camera.size)[:, None] - 1
    corners = np.array([[0, 1, 0, 1], [0, 0, 1, 1.0]]) * last_pixel
    return np.arccos(camera.rays(corners)[2].min())


def _mesh(file):
    import open3d as o3d

    if str(file).lower().endswith(".ply") and (problem := ply_problem(file)):
        raise InputError(f"{file}: expected a mesh, found {problem}; save it as PLY, STL or OBJ")
    mesh = o3d.io.read_triangle_mesh(file)
    if not len(mesh.triangles):
        raise InputError(
            f"{file}: expected a mesh with triangles, found none; save it as PLY, STL or OBJ"
        )
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles)


def _images(scene, take: _Take, folder) -> Iterator[Mapping]:
    """Render and write the images of one take; their rows of images.csv."""
    seed = int(
        np.random.SeedSequence((scene.seed, _ROLES.index(take.role), take.place)).generate_state(1)[
            0
        ]
    )
    instrument = scene.instrument
    moment = Moment(scene.causes, take.covariates)
    common = {"role": take.role, "placement": "", "scan": "", **take.row, **take.covariates}
    if take.role == "board":
        name = f"images/board-{take.place:03d}.png"
        _save(folder / name, render_board(instrument, take.surfaces, moment, seed, scene.parts[0]))
        yield {"image": name, **common}
        return
    moments = [moment] * len(instrument.steps)
    sweep = render_scan(instrument, take.surfaces, moments, seed, scene.parts[1])
    backwards = take.covariates.get("sweep", 1) < 0
    for k, image in enumerate(sweep):
        role = "scan" if take.role == "scan" else "board"
        name = f"images/{role}-{take.place:03d}-step-{instrument.steps[k]:03d}.png"
        _save(folder / name, image)
        since = (len(moments) - 1 - k if backwards else k) * take.seconds
        row = {"image": name, **common, "step": int(instrument.steps[k])}
        row["time_s"] = round(take.covariates["time_s"] + since, 4)
        if instrument.angles is not None:
            row["mirror_deg"] = round(float(np.rad2deg(instrument.angles[k])), 9)
        yield row


def _save(path, image):
    """Written as bytes: a full disk then is an error, where OpenCV only returns a flag."""
    import cv2

    with _writing(path):
        path.write_bytes(cv2.imencode(path.suffix, image)[1].tobytes())


@contextmanager
def _writing(path):
    """A disk that is full or write-protected is a sentence, not a fault of the programme."""
    try:
        yield
    except OSError as problem:
        raise InputError(
            f"{path}: expected a place to write a recording to, found the system's "
            f"'{problem.strerror or problem}'; make room or choose another folder"
        ) from problem


def _write(scene: Scene, folder: Path, recording: Made, stations: Stations | None) -> None:
    """images.csv, artefact.csv, samples.csv, robot.toml, and last recording.toml."""
    _write_csv(folder / "images.csv", recording.images)
    scans = any(row["role"] != "board" for row in recording.images)
    keys = {
        "format": "recording/1",
        "title": scene.title,
        "measures": "scan-images" if scans else "board-images",
        "source": "rendered",
        "images": {"file": "images.csv"},
        "board": scene.board.recorded,
    }
    if scene.balls:
        keys["artefact"] = {"file": "artefact.csv"}
        names = ("ball", "x_mm", "y_mm", "z_mm", "radius_mm")
        _write_csv(
            folder / "artefact.csv",
            [dict(zip(names, (k + 1, *b))) for k, b in enumerate(scene.balls)],
        )
    if stations is not None and stations.columns:
        keys["samples"] = {"file": "samples.csv"}
        columns = {name: np.asarray(values).tolist() for name, values in stations.columns.items()}
        _write_csv(
            folder / "samples.csv", [dict(zip(columns, cells)) for cells in zip(*columns.values())]
        )
        if stations.robot:
            _write_toml(folder / "robot.toml", stations.robot)
        if stations.robot or stations.section:
            keys["robot"] = dict(stations.section) or {"file": "robot.toml"}
    _write_toml(folder / "recording.toml", keys)


def _write_csv(path, rows) -> None:
    names = dict.fromkeys(name for row in rows for name in row)
    with _writing(path), path.open("w", encoding="utf-8", newline="") as file:
        write_rows(file, [names])
        write_rows(file, ([row.get(name, "") for name in names] for row in rows))


def _write_toml(path, keys) -> None:
    import tomli_w

    with _writing(path):
        path.write_text(tomli_w.dumps(keys), encoding="utf-8", newline="\n")


def _truth(scene: Scene, boards: np.ndarray, artefacts: np.ndarray, takes: list[_Take]) -> dict:
    """Everything that a calibration should find; poses as six numbers, mm and rad."""
    instrument = scene.instrument
    found: dict = {"title": scene.title, "camera": camera_keys(instrument.camera)}
    if len(instrument.steps):
        planes = zip(instrument.steps, instrument.nominal_planes().T)
        found["planes"] = [
            {"step": int(k), "normal": p[:3].tolist(), "offset_mm": float(p[3])} for k, p in planes
        ]
    if (mirror := instrument.mirror) is not None:
        vectors = {
            name: getattr(mirror, name).tolist() for name in ("axis", "point", "face", "beam")
        }
        found["mirror"] = vectors | {"offset_mm": float(mirror.offset)}
    found["effects"] = [
        {"effect": c.effect, "where": c.where, **(c.model_extra or {}), "values": c.values}
        for c in scene.effect
    ]
    found["boards"] = [
        {"placement": k + 1, "T_camera_board": pose.tolist()} for k, pose in enumerate(boards)
    ]
    scans = [take for take in takes if take.role == "scan"]
    found["scans"] = [_scan_truth(take, pose) for take, pose in zip(scans, artefacts)]
    return found


def _scan_truth(take: _Take, pose: np.ndarray) -> dict:
    """Pose of the artefact, and the balls in view as they truly stood, camera frame."""
    balls = [
        {"ball": s.number, "centre_mm": s.centre.tolist(), "radius_mm": float(s.radius)}
        for s in take.surfaces
        if isinstance(s, BallSurface)
    ]
    return {"scan": take.place, "T_camera_artefact": pose.tolist(), "balls": balls}
