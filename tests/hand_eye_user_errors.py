"""Mistakes that people make with hand-eye recordings, planted into recordings that are right."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from unittest.mock import patch

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.samples.columns import joint_columns
from hand_eye_recordings import CAMERA, SCENES, Made, camera_text, flange_columns
from sensors.boards.detection import detect_all
from workbench.core.errors import InputError
from workbench.core.rigid import inverse, rotation_vector, transform

BEYOND_MM, BEYOND_DEG = 3.0, 0.5
"""A result that is this far from the truth is wrong: several sigmas of these recordings."""

# Mistakes: each takes what is right and gives a recording, and the kind and the camera that the user names.


@dataclass(frozen=True)
class Mistake:
    """`plant` makes the recording wrong; `words`: the sentence that names the cause holds one of them; `of`: the
    columns that it needs, "flange", "joints" or "any"."""

    plant: Callable[[Made], Made]
    words: tuple[str, ...]
    of: str = "flange"


def with_flange(change):
    def plant(right: Made) -> Made:
        recording = right.recording
        poses = change(recording.flange, right)
        return replace(
            right,
            recording=replace(recording, columns={**recording.columns, **flange_columns(poses)}),
        )

    return plant


def with_place(change):
    return with_flange(lambda poses, right: transform(poses[:, :3, :3], change(poses[:, :3, 3])))


def with_turn(change):
    def turned(poses, right):
        made = change(Rotation.from_matrix(poses[:, :3, :3]))
        return transform(made.as_matrix(), poses[:, :3, 3])

    return with_flange(turned)


def with_columns(change):
    def plant(right: Made) -> Made:
        columns = {**right.recording.columns, **change(right.recording.columns)}
        return replace(right, recording=replace(right.recording, columns=columns))

    return plant


def with_board(**keys):
    def plant(right: Made) -> Made:
        board = dict(right.recording.board)
        changed = {name: value(board) for name, value in keys.items()}
        return replace(right, recording=replace(right.recording, board={**board, **changed}))

    return plant


def square(factor):
    def plant(right: Made) -> Made:
        board = dict(right.recording.board)
        board["square_mm"] *= factor
        if "marker_mm" in board:
            board["marker_mm"] *= factor
        return replace(right, recording=replace(right.recording, board=board))

    return plant


def with_samples(order):
    """Images that name the sample of another one."""

    def plant(right: Made) -> Made:
        images = right.recording.images
        rows = [
            {**row, "sample": images[k]["sample"]} for row, k in zip(images, order(len(images)))
        ]
        return replace(right, recording=replace(right.recording, images=tuple(rows)))

    return plant


def exchanged(count):
    order = list(range(count))
    order[1], order[count // 2] = order[count // 2], order[1]
    return order


def moved_midway(shift, degrees, what):
    """The sensor, or the board, has another pose from the middle of the recording on."""
    away = transform(
        Rotation.from_euler("xyz", [degrees, -degrees / 2, degrees / 3], degrees=True).as_matrix(),
        np.array([shift, -shift / 2, shift / 2]),
    )

    def change(poses, right):
        late = np.arange(len(poses)) >= len(poses) // 2
        inside = right.sensor @ inverse(away) @ inverse(right.sensor)
        if what == "sensor":
            moved = poses @ inside if right.kind == "in-hand" else inverse(inside) @ poses
        else:
            moved = away @ poses if right.kind == "in-hand" else poses @ away
        return np.where(late[:, None, None], moved, poses)

    return with_flange(change)


def permuted(count):
    return np.random.default_rng(5).permutation(count)


def as_degrees(turn):
    """Angles in degrees handed to a function that takes radians."""
    return Rotation.from_euler("xyz", turn.as_euler("xyz", degrees=True))


def first_joint(change):
    def of(columns):
        names = joint_columns(columns)
        return change(columns, names)

    return with_columns(of)


OTHER_CAMERA = "camera of another zoom"
SWAPPED_KIND = {"in-hand": "to-hand", "to-hand": "in-hand"}
MISTAKES = {
    "board square × 2": Mistake(square(2), ("squares of the board look",), "any"),
    "board square × 1.05": Mistake(square(1.05), ("squares of the board look",), "any"),
    "board square in metres": Mistake(square(0.001), ("squares of the board look",), "any"),
    "flange positions in inches": Mistake(with_place(lambda p: p / 25.4), ("inches",)),
    "flange positions in metres": Mistake(with_place(lambda p: p / 1000), ("metres",)),
    "quaternion written x, y, z, w": Mistake(
        with_turn(lambda r: Rotation.from_quat(np.roll(r.as_quat(), -1, axis=1))),
        ("order x, y, z, w",),
    ),
    "mirrored flange frame": Mistake(
        with_flange(lambda p, right: np.diag([1, -1, 1, 1.0]) @ p @ np.diag([1, -1, 1, 1.0])),
        ("mirrored",),
    ),
    "z of the flange negated": Mistake(with_place(lambda p: p * [1, 1, -1]), ("flange_z_mm",)),
    "y and z exchanged": Mistake(with_place(lambda p: p[:, [0, 2, 1]]), ("position columns",)),
    "camera moved midway": Mistake(moved_midway(12.0, 3.0, "sensor"), ("camera", "moved between")),
    "camera slipped midway": Mistake(moved_midway(3.0, 0.7, "sensor"), ("camera", "moved between")),
    "board moved midway": Mistake(moved_midway(10.0, 4.0, "board"), ("board", "moved between")),
    "images permuted": Mistake(with_samples(permuted), ("permuted",), "any"),
    "images shifted by one": Mistake(
        with_samples(lambda n: np.roll(np.arange(n), 1)), ("shifted", "permuted"), "any"
    ),
    "two images exchanged": Mistake(with_samples(exchanged), ("exchanged",), "any"),
    "inverse poses": Mistake(with_flange(lambda p, right: inverse(p)), ("inverted",)),
    "rotations inverted": Mistake(with_turn(lambda r: r.inv()), ("inverted",)),
    "angles in another order": Mistake(
        with_turn(lambda r: Rotation.from_euler("ZYX", r.as_euler("xyz"))), ("in the order",)
    ),
    "radians taken for degrees": Mistake(
        with_turn(lambda r: Rotation.from_euler("xyz", np.radians(r.as_euler("xyz")))), ("radians",)
    ),
    "degrees taken for radians": Mistake(
        with_turn(as_degrees), ("unit of the angles", "degrees given for radians")
    ),
    "rotation vector read as angles": Mistake(
        with_turn(lambda r: Rotation.from_euler("xyz", r.as_rotvec())), ("rotation vector",)
    ),
    "eye-in-hand for eye-to-hand": Mistake(
        lambda m: replace(m, kind=SWAPPED_KIND[m.kind]), ("--kind",), "any"
    ),
    "one pose not updated": Mistake(
        with_flange(lambda p, right: p[[0, 1, 2, 3, 3, *range(5, len(p))]]), ("image", "pose 4")
    ),
    "one row fewer on the board": Mistake(
        with_board(rows=lambda b: b["rows"] - 1), ("expected",), "any"
    ),
    "another kind of board": Mistake(
        with_board(
            kind=lambda b: "chessboard" if b["kind"] != "chessboard" else "circles",
            asymmetric=lambda b: False,
        ),
        ("correct",),
        "any",
    ),
    OTHER_CAMERA: Mistake(
        lambda m: replace(m, camera=other_camera(m)), ("camera", "does not belong"), "any"
    ),
    "joint 2 with the wrong sign": Mistake(
        first_joint(lambda c, names: {names[1]: -c[names[1]]}),
        ("q2_deg", "opposite sign"),
        "joints",
    ),
    "joints 4 and 5 exchanged": Mistake(
        first_joint(lambda c, names: {names[3]: c[names[4]], names[4]: c[names[3]]}),
        ("exchanged",),
        "joints",
    ),
    "joint 1 in radians": Mistake(
        first_joint(lambda c, names: {names[2]: np.radians(c[names[2]])}), ("radians",), "joints"
    ),
    "zero of joint 3 displaced by 90 deg": Mistake(
        first_joint(lambda c, names: {names[2]: c[names[2]] + 90}),
        ("zero of column q3_deg",),
        "joints",
    ),
    "wrong robot file": Mistake(
        lambda m: replace(m, recording=replace(m.recording, robot={"builtin": "ur10"})),
        ("robot looks",),
        "joints",
    ),
}


@cache
def zoomed(home: Path, factor: float) -> Path:
    path = home / "zoomed.toml"
    path.write_text(camera_text(replace(CAMERA, fx=CAMERA.fx * factor, fy=CAMERA.fy * factor)))
    return path


def other_camera(right: Made) -> Path | None:
    return zoomed(right.camera.parent, 1.25) if right.camera else None


# What becomes of them


@dataclass(frozen=True)
class Outcome:
    """`what`: "refused", "warned", "silent" or "harmless"; `sentence` that was said; whether it names the cause."""

    what: str
    sentence: str
    named: bool


_DETECTED: dict = {}


def detected(recording, progress=None):
    """`detect_all`, once for recordings whose images and board agree: most mistakes are in the poses."""
    key = (str(recording.folder), repr(recording.board), repr(recording.images))
    if key not in _DETECTED:
        _DETECTED[key] = detect_all(recording)
    return _DETECTED[key]


def outcome(wrong: Made, right: Made, words=()) -> Outcome:
    """What the workbench makes of a recording; `right` holds the true sensor pose."""
    from workbench.jobs.sensor import hand_eye

    try:
        with patch.object(hand_eye, "detect_all", detected):
            run = hand_eye.calibrate(wrong.recording, wrong.camera, wrong.kind, lambda text: None)
    except InputError as problem:
        return Outcome("refused", str(problem), _names(str(problem), words))
    answer = hand_eye.as_json(run)
    said = " ".join(answer["warnings"])
    if said:
        return Outcome("warned", said, _names(said, words))
    away = np.linalg.norm(run.made.sensor[:3, 3] - right.sensor[:3, 3])
    turned = np.degrees(
        np.linalg.norm(rotation_vector(run.made.sensor[:3, :3] @ right.sensor[:3, :3].T))
    )
    is_right = away < BEYOND_MM and turned < BEYOND_DEG and run.made.kind == right.kind
    return Outcome("harmless" if is_right else "silent", "", False)


def _names(sentence, words):
    return any(word in sentence for word in words)


def outcomes(right: Made, name: str) -> dict[str, Outcome]:
    """What becomes of every mistake that can be made in a recording."""
    has = "flange" if right.recording.flange is not None else "joints"
    fitting = {key: one for key, one in MISTAKES.items() if one.of in ("any", has)}
    if name not in SCENES:
        fitting.pop(OTHER_CAMERA)
    return {key: outcome(one.plant(right), right, one.words) for key, one in fitting.items()}
