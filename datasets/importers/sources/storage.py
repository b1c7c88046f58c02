"""YAML, XML and JSON files of cameras and targets: OpenCV FileStorage and Kalibr's target YAML."""

import re
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.source import Source
from datasets.importers.sources.arrays import pose_columns, tables_of_arrays
from datasets.importers.sources.numbered_records import numbered_records
from datasets.importers.sources.records import read_record_tables
from datasets.importers.sources.xml_records import read_xml_records
from workbench.core.text.structured_text import ContentError, parse_json, read_json, read_yaml

XML, JSON_LINES = {".xml", ".dtx"}, {".jsonl", ".ndjson"}
EXTENSIONS = {".yml", ".yaml", ".json", *XML, *JSON_LINES}
_HEAD_BYTES = 4096
_FILE_STORAGE = re.compile(r"%YAML:1\.0|opencv_storage|opencv-matrix")
_NUMBERED_PART = re.compile(
    r"(?:(R|rvec|rot|rotation|rmat)|(t|tvec|trans|translation))s?(?:[_ ]+(.*?))?[_ ]?(\d+)", re.I
)


def read_storage(path: Path) -> Source:
    """A board from Kalibr's YAML, or tables and a camera from OpenCV's FileStorage. Raises InputError for others."""
    if "target_type" in _head(path):
        return read_kalibr_target(path)
    if is_file_storage(path):
        return read_opencv(path)
    if path.suffix.lower() in XML:
        return Source(tables=tuple(read_xml_records(path)))
    if path.suffix.lower() in JSON_LINES:
        return Source(tables=tuple(read_record_tables(path, _json_lines(path))))
    if path.suffix.lower() == ".json":
        return Source(tables=tuple(read_record_tables(path, _json(path))))
    return Source(tables=tuple(read_record_tables(path, _yaml(path))))


def is_file_storage(path: Path) -> bool:
    """Whether a file begins as OpenCV's FileStorage does."""
    return _FILE_STORAGE.search(_head(path)) is not None


def _head(path: Path) -> str:
    with path.open("rb") as file:
        return file.read(_HEAD_BYTES).decode("utf-8", errors="replace")


def _yaml(path: Path):
    """The records of a YAML file, as MoveIt and `rostopic echo` write them. Raises InputError for other files."""
    try:
        content = read_yaml(path, has_documents=True)
    except (OSError, ContentError) as problem:
        raise complaint(path.name, "YAML", f"a mistake ({problem})", "write it again") from None
    if isinstance(content, list | dict):
        return content
    raise complaint(
        path.name,
        "an OpenCV FileStorage, a Kalibr target or records",
        "none of them",
        "name the file that holds the poses or the target",
    )


def _json(path: Path):
    """Raises InputError for text that is no JSON."""
    try:
        return read_json(path)
    except (OSError, ContentError) as problem:
        raise complaint(path.name, "JSON", f"a mistake ({problem})", "write it again") from None


def _json_lines(path: Path) -> list:
    """The records of a file with one JSON value on each line. Raises InputError for a line that is none."""
    records = []
    for number, line in enumerate(
        path.read_text(encoding="utf-8", errors="replace").splitlines(), 1
    ):
        if not line.strip():
            continue
        try:
            records.append(parse_json(line))
        except ContentError as problem:
            raise complaint(
                f"{path.name}, row {number}", "JSON", f"a mistake ({problem})", "correct the row"
            ) from None
    return records


def read_kalibr_target(path: Path) -> Source:
    """[board] of a Kalibr target (checkerboard, circlegrid, aprilgrid). Lengths of Kalibr are metres.

    Raises InputError for another target and for missing keys.
    """
    try:
        keys = read_yaml(path)
        board = _kalibr_board(keys, path)
    except KeyError as missing:
        raise complaint(
            f"{path.name}, key {missing}", "this key of a Kalibr target", "none", "add it"
        ) from None
    except (OSError, OverflowError, TypeError, ValueError) as problem:
        raise complaint(
            path.name, "a Kalibr target in YAML", f"{problem}", "correct the file"
        ) from None
    if keys.get("asymmetricGrid"):
        board["asymmetric"] = True
    return Source(board=board)


def _kalibr_board(keys: dict, path: Path) -> dict:
    """[board] of the keys of a target. Raises KeyError, TypeError and ValueError for keys that cannot be right."""
    kind = keys["target_type"]
    if kind == "aprilgrid":
        side = float(keys["tagSize"])
        pitch = side * (1 + float(keys["tagSpacing"]))  # the spacing is a share of the tag
        return {
            "kind": "aprilgrid",
            "columns": int(keys["tagCols"]),
            "rows": int(keys["tagRows"]),
            "square_mm": round(1000 * pitch, 9),
            "marker_mm": round(1000 * side, 9),
        }
    if kind not in ("checkerboard", "circlegrid"):
        raise complaint(
            f"{path.name}, key target_type",
            "checkerboard, circlegrid or aprilgrid",
            repr(kind),
            "name the file of another target",
        )
    spacing = keys["rowSpacingMeters"] if kind == "checkerboard" else keys["spacingMeters"]
    return {
        "kind": "chessboard" if kind == "checkerboard" else "circles",
        "columns": int(keys["targetCols"]),
        "rows": int(keys["targetRows"]),
        "square_mm": round(1000 * float(spacing), 9),
    }


def read_opencv(path: Path) -> Source:
    """Tables of the matrices, and a camera where camera_matrix is there. Raises InputError where it cannot be read."""
    arrays = stored_arrays(path)
    if arrays is None:
        raise complaint(
            path.name, "an OpenCV FileStorage", "a file that OpenCV cannot read", "write it again"
        )
    camera = _camera(arrays)
    rows = _numbered_rows(_joined_vectors(arrays))
    poses = _poses({**arrays, **_joined_parts(arrays)})
    arrays = {name: value for name, value in arrays.items() if value.ndim == 2 and len(value) >= 3}
    no_table = {(3, 1), (3, 3), (4, 4)} if poses else {(3, 3), (4, 4)}
    arrays = {name: value for name, value in arrays.items() if value.shape not in no_table}
    arrays = {name: value for name, value in arrays.items() if not _is_numbered_row(name, rows)}
    arrays |= {**poses, **rows}
    if camera is not None and not arrays:
        return Source(camera=camera)
    return Source(tables=tuple(tables_of_arrays(path, arrays)), camera=camera)


def stored_arrays(path: Path) -> dict[str, np.ndarray] | None:
    """Names and arrays of all matrices and lists of numbers of a FileStorage; None where OpenCV cannot read it."""
    import cv2

    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        arrays = dict(_matrices(storage.root())) if storage.isOpened() else None
        storage.release()
    except (cv2.error, SystemError, UnicodeError, RecursionError, ValueError):
        return None  # SystemError: text of the file that is not UTF-8, in OpenCV's Python binding
    return arrays


def _matrices(node, prefix: str = ""):
    """Names and arrays of all matrices below a node; sequences of numbers count as one row each."""
    for name in node.keys():
        child = node.getNode(name)
        called = f"{prefix}{name}"
        matrix = child.mat() if child.isMap() else None
        if matrix is not None:
            yield called, np.asarray(matrix, float)
        elif child.isMap():
            yield from _matrices(child, f"{called} ")
        elif child.isSeq():
            yield from _sequence(child, called)


def _sequence(node, called: str):
    items = [node.at(k) for k in range(node.size())]
    if items and all(item.isReal() or item.isInt() for item in items):
        yield called, np.array([item.real() for item in items])[:, None]
        return
    for number, item in enumerate(items):
        matrix = item.mat() if item.isMap() else None
        if matrix is not None:
            yield f"{called}_{number}", np.asarray(matrix, float)


def _joined_vectors(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays, with numbered positions and rotations of three numbers (rvec_0, tvec_0, ...) as one vector (6,)."""
    pose_parts: dict[tuple[str, str], dict[bool, str]] = {}
    for name, value in arrays.items():
        found = _NUMBERED_PART.fullmatch(name)
        if found and value.size == 3:
            pose_parts.setdefault((found[3] or "pose", found[4]), {})[bool(found[1])] = name
    pairs = {key: names for key, names in pose_parts.items() if len(names) == 2}
    joined = {
        f"{name}_{number}": np.concatenate([arrays[names[k]].ravel() for k in (False, True)])
        for (name, number), names in pairs.items()
    }
    taken = {name for names in pairs.values() for name in names.values()}
    return {name: value for name, value in arrays.items() if name not in taken} | joined


def _numbered_rows(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Arrays (n, k) of vectors under numbered names (pose1, pose2, ...), and (n, 1) their numbers; {} without any."""
    vectors = {
        name: value.ravel().tolist()
        for name, value in arrays.items()
        if value.ndim == 1 or 1 in value.shape
    }
    records = [
        record for record in numbered_records(vectors, "pose") or () if None not in record.values()
    ]
    return {
        name: np.array([record[name] for record in records], float).reshape(len(records), -1)
        for name in (records[0] if records else ())
        if name not in vectors
    }


def _is_numbered_row(name: str, rows: dict[str, np.ndarray]) -> bool:
    """Whether a vector is one of the rows that `_numbered_rows` found, or a part of one."""
    part = _NUMBERED_PART.fullmatch(name)
    stem = part[3] or "pose" if part else re.sub(r"[ _.\-]?\d+$", "", name)
    return stem in rows


def _joined_parts(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Numbered 4 x 4 matrices of rotations (R_gripper2base_0, ...) and translations with the same end of their name."""
    parts_of_pose: dict[tuple[str, str], dict[bool, np.ndarray]] = {}
    for name, value in arrays.items():
        found = _NUMBERED_PART.fullmatch(name)
        if found and value.shape in ((3, 3), (3, 1), (1, 3)):
            is_rotation = bool(found[1]) and value.shape == (3, 3)
            parts_of_pose.setdefault((found[3] or "pose", found[4]), {})[is_rotation] = value
    made = {}
    for (name, number), pose_parts in parts_of_pose.items():
        if len(pose_parts) == 2:
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = pose_parts[True], pose_parts[False].ravel()
            made[f"{name}_{number}"] = pose
    return made


def _poses(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns of numbered 4 x 4 matrices (pose_0, pose_1, ...), by the name in front of the number."""
    numbered: dict[str, list[tuple[int, np.ndarray]]] = {}
    for name, value in arrays.items():
        found = re.fullmatch(r"(.*?)[_ ]?(\d+)", name)
        if found and value.shape == (4, 4):
            numbered.setdefault(found[1], []).append((int(found[2]), value))
    columns: dict[str, np.ndarray] = {}
    for name, poses in numbered.items():
        stacked = np.stack([pose for _, pose in sorted(poses, key=lambda item: item[0])])
        for called, cells in pose_columns(name, stacked).items():
            columns[called] = cells[:, None]
    return columns


def _camera(arrays: dict[str, np.ndarray]) -> dict | None:
    """Keys of guess.camera from camera_matrix and distortion_coefficients."""
    named = {name.lower().split()[-1]: value for name, value in arrays.items()}
    matrix = next(
        (named[k] for k in ("camera_matrix", "cameramatrix", "k", "m1") if k in named), None
    )
    if matrix is None or matrix.shape != (3, 3):
        return None
    distortion = next(
        (
            named[k]
            for k in ("distortion_coefficients", "dist_coeffs", "distcoeffs", "d", "d1")
            if k in named
        ),
        None,
    )
    camera = {
        "fx_px": float(matrix[0, 0]),
        "fy_px": float(matrix[1, 1]),
        "cx_px": float(matrix[0, 2]),
        "cy_px": float(matrix[1, 2]),
    }
    if distortion is not None:
        values = [float(v) for v in distortion.ravel()]
        size = 5 if len(values) <= 5 else 8
        camera["distortion"] = (values + [0.0] * size)[:size]
    return camera
