"""Small recordings of every kind, written by hand as a laboratory would, and real recordings by name."""

from pathlib import Path

import cv2
import numpy as np

import datasets
from datasets.samples.columns import KINDS

JOINTS = ("q1_deg", "q2_deg", "q3_deg", "q4_deg", "q5_deg", "q6_deg")
ROWS = (
    (0, 330, 50, -90),
    (-90, 0, 330, 180),
    (0, 0, 35, -90),
    (0, -335, 0, 90),
    (180, 0, 0, 90),
    (0, -80, 0, 180),
)
BALLS = {1: (0, 0, 0), 2: (100, 0, 0), 3: (0, 150, 0), 4: (60, 60, 40)}
POSES = 6


def robot_toml() -> str:
    """A six-axis arm with limits, a parallel pair of axes and one coupled joint."""
    lines = [
        'name = "test arm"',
        'convention = "distal"',
        "gravity = [0.0, 0.0, -1.0]",
        'source = "made for a test"',
    ]
    for k, (theta, d, a, alpha) in enumerate(ROWS, 1):
        lines += [
            "[[joint]]",
            f"theta_deg = {theta}",
            f"d_mm = {d}",
            f"a_mm = {a}",
            f"alpha_deg = {alpha}",
            f"hayati = {str(k == 2).lower()}",
            "limits_deg = [-190, 190]",
        ]
        lines += ["coupled = { joint = 2, ratio = 1.0 }"] if k == 3 else []
    return "\n".join(lines) + "\n"


def artefact_csv() -> str:
    rows = [f"{ball},{x},{y},{z},15.0" for ball, (x, y, z) in BALLS.items()]
    return "\n".join(["ball,x_mm,y_mm,z_mm,radius_mm", *rows]) + "\n"


def recording_toml(measures: str) -> str:
    kind = KINDS[measures]
    lines = [
        'format = "recording/1"',
        'title = "test"',
        f'measures = "{measures}"',
        "sigma_mm = 0.02",
        "[robot]",
        'file = "robot.toml"',
        "[samples]",
        'file = "samples.csv"',
    ]
    lines += ["[artefact]", 'file = "artefact.csv"'] if kind.artefact else []
    lines += (
        [
            "[images]",
            'file = "images.csv"',
            "[board]",
            'kind = "chessboard"',
            "columns = 11",
            "rows = 8",
            "square_mm = 5.0",
        ]
        if kind.images
        else []
    )
    return "\n".join(lines) + "\n"


def samples_csv(measures: str) -> str:
    """POSES static poses; balls seen from each of them keep their distance."""
    rng = np.random.default_rng(3)
    rows = []
    for pose in range(1, POSES + 1):
        q = rng.uniform(-80, 80, 6)
        where = (
            rng.uniform(-20, 20, 3) + (0, 0, 200)
            if KINDS[measures].artefact
            else rng.uniform(-600, 600, 3) + (2000, 0, 0)
        )
        for ball in (1, 2):
            rows.append(_row(measures, len(rows) + 1, pose, ball, q, where))
    return (
        "\n".join([",".join(rows[0]), *(",".join(str(v) for v in row.values()) for row in rows)])
        + "\n"
    )


def _row(
    measures: str, sample: int, pose: int, ball: int, q: np.ndarray, where: np.ndarray
) -> dict:
    row = {"sample": sample, **{name: round(v, 4) for name, v in zip(JOINTS, q)}}
    point = where + BALLS[ball]
    half = np.sqrt(0.5)
    values = {
        "ball": ball,
        "x_mm": point[0],
        "y_mm": point[1],
        "z_mm": point[2],
        "qw": half,
        "qx": half,
        "qy": 0.0,
        "qz": 0.0,
        "point": 1 + pose // 4,
        "sphere": 1,
        "pair": pose,
        "length_mm": 100 + pose,
        "plane": 1,
    }
    row |= {name: values[name] for name in KINDS[measures].columns}
    row |= {"nx": 0.6, "ny": 0.8, "nz": 0.0} if KINDS[measures].either else {}
    return row | {
        "pose": pose,
        "approach1": (-1) ** sample,
        "temperature_c": 21.5,
        "time_s": 10 * sample,
    }


def write_good(folder: Path, measures: str = "ball-centre") -> Path:
    """A folder that reads without complaint."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {
        "recording.toml": recording_toml(measures),
        "robot.toml": robot_toml(),
        "samples.csv": samples_csv(measures),
    }
    texts |= {"artefact.csv": artefact_csv()} if KINDS[measures].artefact else {}
    if KINDS[measures].images:
        texts["images.csv"] = (
            "image,role,placement,scan\nimages/a.png,board,1,\nimages/b.png,board-laser,1,\nimages/c.png,scan,,1\n"
        )
        (folder / "images").mkdir(exist_ok=True)
        for name in "abc":
            cv2.imwrite(
                str(folder / "images" / f"{name}.png"), np.full((12, 16), ord(name), np.uint8)
            )
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def real_set(real, name: str):
    """A part of a real recording, such as "handeye_open3dv:in-hand"; `real`: the fixture, which skips if it is absent."""
    real(name.partition(":")[0])
    return datasets.read(name)
