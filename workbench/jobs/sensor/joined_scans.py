"""Scans whose images are joined: the robot moves the sensor between images, or a turntable moves the object.

A scan is joined by flange pose where its rows of images.csv name several rows of samples.csv, and by the turntable
where they hold `table_deg`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.recording import Recording
from sensors.scanner.model import Scanner
from sensors.scanner.motion import Motion
from sensors.scanner.turntable import Turntable
from workbench.core.errors import InputError
from workbench.core.text.structured_text import read_toml
from workbench.files.exports.hand_eye import read_hand_eye
from workbench.files.images.flange import flange_poses, rows_of_samples

FRAME = "base"
TABLE = "table_deg"
_LEAST_MM = 1e-4


@dataclass(frozen=True, eq=False)
class KnownHandEye:
    """`matrix` (4, 4) T_flange_sensor, mm; `covariance` (6, 6) of x y z (mm) and of a small rotation (rad), in the axes
    of the flange; `position_mm`: 1 sigma of the position of a flange pose."""

    matrix: np.ndarray
    covariance: np.ndarray
    position_mm: float = 0.0


@dataclass(frozen=True, eq=False)
class Motions:
    """Motion of each joined scan: `flange` (m, 4, 4) of the samples (m,) with `hand_eye`, and `table`."""

    recording: Recording | None = None
    flange: np.ndarray | None = None
    hand_eye: KnownHandEye | None = None
    table: Turntable | None = None

    def of(self, rows: Sequence[Mapping]) -> Motion | None:
        """Motion of the images `rows` of one scan; None where nothing moved."""
        if is_on_turntable(rows):
            return self.table.motion(np.deg2rad([row[TABLE] for row in rows]))
        if not is_moved_by_robot(rows):
            return None
        place = rows_of_samples(self.recording, [row["sample"] for row in rows])
        return moved_by_robot(self.flange[place], self.hand_eye)


def is_moved_by_robot(rows: Sequence[Mapping]) -> bool:
    """Whether images of one scan were taken at several rows of samples.csv."""
    return len({int(row["sample"]) for row in rows if "sample" in row}) > 1


def is_on_turntable(rows: Sequence[Mapping]) -> bool:
    """Whether images of one scan state the angle of a turntable."""
    return any(TABLE in row for row in rows)


def is_joined(rows: Sequence[Mapping]) -> bool:
    """Whether the images of one scan have to be joined."""
    return is_on_turntable(rows) or is_moved_by_robot(rows)


def motions_of(
    recording: Recording,
    scanner: Scanner,
    groups: Mapping[str, Sequence[Mapping]],
    hand_eye_file: Path | None,
    progress: Callable[[str], None],
) -> Motions:
    """Motions that join the scans `groups` of a recording. Raises InputError if data that they need are missing."""
    on_turntable = [name for name, rows in groups.items() if is_on_turntable(rows)]
    moved = [name for name, rows in groups.items() if is_moved_by_robot(rows)]
    for name in on_turntable:
        _check_turntable(recording, name, groups[name], scanner)
    if not moved:
        _check_unused(recording, hand_eye_file)
        return Motions(recording, table=scanner.turntable)
    _check_samples(recording, moved[0], groups[moved[0]])
    if hand_eye_file is not None:
        known = read_known(hand_eye_file)
    else:
        known = _from_boards(recording, scanner, moved[0], progress)
    return Motions(recording, flange_poses(recording), known, scanner.turntable)


def _check_unused(recording, hand_eye_file) -> None:
    if hand_eye_file is not None:
        raise InputError(
            f"--hand-eye {hand_eye_file}: expected scans whose images name several rows of samples.csv, found none in "
            f"{recording.name}; add the column sample to images.csv, or omit the option"
        )


def _check_turntable(recording, name, rows, scanner: Scanner) -> None:
    called = f"{recording.name}, images.csv, scan {name}, column {TABLE}"
    if not all(TABLE in row for row in rows):
        raise InputError(
            f"{called}: expected the angle of the turntable in every image of the scan, found an empty cell; fill it in"
        )
    if is_moved_by_robot(rows):
        raise InputError(
            f"{called}: expected a sensor that stands still before the turntable, found several rows of samples.csv; "
            "give the scan one sample, or split it"
        )
    if scanner.turntable is None:
        raise InputError(
            f"{called}: expected a scanner with a calibrated turntable, found none; add images of a board that stands "
            f"on the table, with their {TABLE}, and calibrate the scanner again"
        )


def _check_samples(recording, name, rows) -> None:
    if not all("sample" in row for row in rows):
        raise InputError(
            f"{recording.name}, images.csv, scan {name}, column sample: expected a row of samples.csv for every image, "
            "found an empty cell; fill it in"
        )


def _from_boards(recording, scanner, name, progress) -> KnownHandEye:
    """The hand-eye transform from the recording's own images of a board, with the scanner's camera."""
    from workbench.files.images.images import by_role
    from workbench.jobs.sensor import hand_eye

    if not any("sample" in row for row in by_role(recording, "board")):
        raise InputError(
            f"{recording.name}, images.csv, scan {name}: expected a hand-eye transform to join images of several "
            "flange poses, found none; name one with --hand-eye FILE (`workbench handeye`), or add the column sample "
            "to images of a board that stands still in the base frame"
        )
    hand_eye_result = hand_eye.calibrate(recording, scanner.camera, hand_eye.IN_HAND, progress).made
    if not np.isfinite(hand_eye_result.covariance).all():
        raise InputError(
            f"{recording.name}: expected board images that determine the hand-eye transform, found "
            f"{'; '.join(hand_eye_result.undetermined)}; add poses with rotations about two axes"
        )
    return KnownHandEye(
        hand_eye_result.sensor,
        hand_eye_result.covariance,
        hand_eye_result.robot_sigma.get("position_mm", 0.0),
    )


def read_known(path: Path) -> KnownHandEye:
    """The hand-eye transform of a hand-eye.toml with its uncertainty. Raises InputError."""
    read = read_hand_eye(path)
    if read.parent != "flange":
        raise InputError(
            f"{path}: expected T_flange_sensor of a sensor on the flange, found a sensor that stands still; name the "
            "file of this sensor"
        )
    keys = read_toml(path)  # `read_hand_eye` has read it before, so it is readable
    std = np.concatenate(
        [keys.get("std_mm", [0.0] * 3), np.deg2rad(keys.get("std_deg", [0.0] * 3))]
    )
    covariance = np.array(keys.get("covariance", np.diag(std**2)), float)
    if covariance.shape != (6, 6) or not np.isfinite(covariance).all():
        raise InputError(
            f"{path}, key covariance: expected 6 x 6 finite numbers, found others; calibrate the hand-eye again"
        )
    position = float(keys.get("robot_sigma", {}).get("position_mm", 0.0))
    return KnownHandEye(read.matrix, covariance, position)


def moved_by_robot(flange: np.ndarray, known: KnownHandEye) -> Motion:
    """Motion of a sensor on the flange at poses (F, 4, 4) T_base_flange."""
    poses = flange @ known.matrix
    axes = flange[:, :3, :3].transpose(0, 2, 1)  # row k: axis k of the flange in the base
    common = np.zeros((len(flange), 6, 6))
    common[:, :3, :3], common[:, 3:, 3:] = axes, axes
    common[:, 3:, :3] = -np.cross(axes, poses[:, None, :3, 3])
    twist = np.zeros((len(flange), 3, 6))
    twist[:, :, :3] = np.eye(3)
    variance = max(known.position_mm, _LEAST_MM) ** 2 * np.eye(3)
    return Motion(FRAME, poses, common, known.covariance, twist, variance, absorbs_frame=True)
