"""Seeds of the fuzzing tests for what `import` takes: flange poses with ball centres or clouds, mappings, damaged PLY."""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fuzz_engine import Target

MAPPING = """format = "import/1"
measures = "external-pose"
robot = "abb_irb120"
[joints]
columns = ["q1_deg", "q2_deg", "q3_deg", "q4_deg", "q5_deg", "q6_deg"]
unit = "deg"
[point]
columns = ["x_mm", "y_mm", "z_mm"]
unit = "mm"
[rotation]
columns = ["qw", "qx", "qy", "qz"]
convention = "quaternion wxyz"
"""
RADIUS_MM = 15.0
BALL = np.array([640.0, -120.0, 260.0])
"""mm, centre of the ball in the frame of the base."""
SENSOR = np.array([30.0, -20.0, 95.0])
"""mm, origin of the sensor in the frame of the flange; its axes are those of the flange."""


def flange_poses(n: int) -> tuple[Rotation, np.ndarray]:
    """n orientations and origins (n, 3) mm of a flange, whose sensor sees the ball about 150 mm ahead."""
    rng = np.random.default_rng(5)
    turns = Rotation.from_euler("ZYX", rng.uniform([-170, -40, 140], [170, 40, 220], (n, 3)), True)
    ahead = rng.uniform([-20, -20, 130], [20, 20, 170], (n, 3))
    return turns, BALL - turns.apply(SENSOR + ahead)


def centres(turns: Rotation, origins: np.ndarray) -> np.ndarray:
    """(n, 3) mm, centre of the ball in the frame of the sensor, with noise."""
    noise = np.random.default_rng(6).normal(0, 0.02, origins.shape)
    return turns.inv().apply(BALL - origins) - SENSOR + noise


def pose_tables(n: int = 14) -> dict[str, tuple[list[str], np.ndarray]]:
    """Header and rows of flange poses with ball centres, by the way in which the rotation is stated."""
    turns, origins = flange_poses(n)
    seen = centres(turns, origins)
    matrices = np.concatenate([turns.as_matrix(), origins[:, :, None]], 2)
    euler = turns.as_euler("ZYX", degrees=True)
    zyz = turns.as_euler("ZYZ", degrees=True)
    cells = [f"m_{row}{column}" for row in range(3) for column in range(4)]
    measured = ["ball_x", "ball_y", "ball_z"]
    return {
        "flange centres": ([*"XYZABC", *measured], np.hstack([origins, euler, seen])),
        "kawasaki": ([*"XYZOAT", *measured], np.hstack([origins, zyz, seen])),
        "matrices": ([*cells, *measured], np.hstack([matrices.reshape(n, 12), seen])),
    }


def write_scans(folder: Path, n: int = 6) -> None:
    """Clouds of the cap of the ball in the frame of the sensor, and poses.csv with Euler angles."""
    folder.mkdir(exist_ok=True)
    turns, origins = flange_poses(n)
    rng = np.random.default_rng(7)
    lines = ["file,X,Y,Z,A,B,C"]
    for k, centre in enumerate(centres(turns, origins)):
        directions = rng.normal(size=(40, 3)) * [0.5, 0.5, 0.1] - [0, 0, 1]
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        name = f"scan_{k}.xyz"
        np.savetxt(folder / name, centre + RADIUS_MM * directions, "%.4f")
        angles = turns[k].as_euler("ZYX", degrees=True)
        lines.append(",".join(map(str, [name, *origins[k], *angles])))
    (folder / "poses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_table(path: Path, names, rows) -> None:
    lines = [",".join(names), *(",".join(f"{value:.5f}" for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def binary_ply() -> bytes:
    """A cloud in little-endian binary, with a list of faces."""
    head = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\n"
        "property float y\nproperty float z\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    points = struct.pack("<12f", *range(12))
    return head.encode() + points + struct.pack("<B3i", 3, 0, 1, 2)


def import_reader_targets(home: Path) -> Iterator[Target]:
    """Readers alone."""
    from datasets.importers.sources.choice import read_sources
    from datasets.importers.sources.clouds import read_cloud

    for name, (header, rows) in pose_tables().items():
        folder = home / f"table-{name}"
        folder.mkdir()
        _write_table(folder / "table.csv", header, rows)
        yield Target(
            f"table {name}",
            folder,
            "table.csv",
            lambda f: read_sources([f / "table.csv"], f / "scratch"),
        )
    folder = home / "binary-cloud"
    folder.mkdir()
    (folder / "scan.ply").write_bytes(binary_ply())
    yield Target("cloud binary", folder, "scan.ply", lambda f: read_cloud(f / "scan.ply", 1000))


def import_command_targets(home: Path, with_out: Callable) -> Iterator[Target]:
    """Commands; `home` holds the folders of `import_reader_targets`, and `simulated` with the table of an arm.

    with_out: makes the call of a command from its words.
    """
    for name in pose_tables():
        words = ("import", "{}/table.csv", "--yes")
        yield Target(f"import {name}", home / f"table-{name}", "table.csv", with_out(*words))
    clouds = home / "clouds"
    (clouds / "scans").mkdir(parents=True)
    write_scans(clouds / "scans")
    (clouds / "scans" / "poses.csv").rename(clouds / "poses.csv")
    words = ("import", "{}/scans", "{}/poses.csv", "--ball-radius", RADIUS_MM, "--yes")
    yield Target("import cloud poses", clouds, "poses.csv", with_out(*words))
    yield Target("import cloud", clouds, "scans/scan_1.xyz", with_out(*words))
    table = home / "simulated"
    trusting = ("import", "{}/samples.csv", "--robot", "abb_irb120", "--yes", "--trust-data")
    yield Target("import trusting", table, "samples.csv", with_out(*trusting))
    (table / "import.toml").write_text(MAPPING, encoding="utf-8")
    mapped = ("import", "{}/samples.csv", "--map", "{}/import.toml", "--yes")
    yield Target("import map", table, "import.toml", with_out(*mapped))
    yield Target("import mapped table", table, "samples.csv", with_out(*mapped))
