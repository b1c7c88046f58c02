"""ROS 1 and ROS 2 bags through rosbags: joint states, points, poses, transforms and images, message by message.

Each topic with measurements becomes a table with its time in s; images are written to a folder as they are read, so
that a bag of any size needs little memory. ROS fixes the units: m, rad, quaternions x y z w.
"""

from array import array
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.importers.source import ImageFile, RawTable, Source
from datasets.importers.sources.tf_chains import Edge, joined_chains

_FEWEST_ROWS = 3
_XYZ = ("X [m]", "Y [m]", "Z [m]")
_QUATERNION = ("qx", "qy", "qz", "qw")


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a .bag, .db3 or .mcap file, or the folder of a ROS 2 bag."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return path.suffix.lower() in {".bag", ".db3", ".mcap"}


def read_bag(path: Path, scratch: Path) -> Source:
    """Tables and images of a bag; images are written into `scratch`.

    Raises InputError where the bag cannot be read or holds no message of a known kind, ModuleNotFoundError without
    rosbags.
    """
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    folder = path.parent if path.suffix.lower() in {".db3", ".mcap"} else path
    content = _Content(scratch)
    try:
        with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            known = [c for c in reader.connections if _kind(c.msgtype) is not None]
            for connection, stamp, raw in reader.messages(connections=known):
                message = reader.deserialize(raw, connection.msgtype)
                content.add(connection.topic, _kind(connection.msgtype), message, stamp * 1e-9)
    except (AnyReaderError, OSError, KeyError) as problem:
        raise complaint(
            path.name, "a ROS bag", f"one that cannot be read ({problem})", "reindex it"
        ) from None
    tables = content.tables(path.name)
    if not tables:
        raise complaint(
            path.name,
            "joint states, points, poses or transforms",
            "no topic of these kinds",
            "record sensor_msgs/JointState and the measured topic",
        )
    return Source(tables=tables, images=tuple(content.images))


def _kind(msgtype: str) -> str | None:
    name = msgtype.rpartition("/")[2]
    known = {
        "JointState",
        "PointStamped",
        "PoseStamped",
        "TransformStamped",
        "TFMessage",
        "Image",
        "CompressedImage",
    }
    return name if name in known else None


class _Content:
    """Columns of every topic, growing with the messages."""

    def __init__(self, scratch: Path):
        self.scratch = scratch
        self.columns: dict[str, dict[str, array]] = {}
        self.transforms: dict[Edge, list[tuple[float, ...]]] = {}
        self.images: list[ImageFile] = []
        self.start: float | None = None

    def add(self, topic: str, kind: str, message, stamp: float) -> None:
        """Append one message; `stamp` s is when it was recorded, used where its header has none."""
        if kind == "TFMessage":
            for transform in message.transforms:
                pair = (transform.header.frame_id.strip("/"), transform.child_frame_id.strip("/"))
                row = _pose_row(transform.transform)
                self.transforms.setdefault(pair, []).append(
                    (_time(transform, stamp), *row.values())
                )
            return
        time = _time(message, stamp)
        if kind == "JointState":
            row = {
                f"{name} [rad]": float(value) for name, value in zip(message.name, message.position)
            }
            self._append(topic, time, row)
        elif kind == "PointStamped":
            self._append(
                topic, time, dict(zip(_XYZ, (message.point.x, message.point.y, message.point.z)))
            )
        elif kind == "PoseStamped":
            self._append(topic, time, _pose_row(message.pose))
        elif kind == "TransformStamped":
            self._append(topic, time, _pose_row(message.transform))
        else:
            self._add_image(topic, message, time)

    def _append(self, called: str, time: float, row: Mapping[str, float]) -> None:
        columns = self.columns.setdefault(called.strip("/"), {})
        if not columns:
            for name in ("time [s]", *row):
                columns[name] = array("d")
        if set(row) != set(columns) - {"time [s]"}:
            return  # joint states of another device on the same topic
        columns["time [s]"].append(time)
        for name, value in row.items():
            columns[name].append(value)

    def _add_image(self, topic: str, message, time: float) -> None:
        import cv2

        pixels = _pixels(message)
        if pixels is None:
            return
        name = f"{topic.strip('/').replace('/', '-')}-{len(self.images) + 1:05d}.png"
        self.scratch.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(self.scratch / name), pixels)
        self.images.append(ImageFile(self.scratch / name, name, time))

    def tables(self, file: str) -> tuple[RawTable, ...]:
        """A table of each topic that has some rows, and of each transform, those of single links joined."""
        made = []
        edges = {pair: np.array(rows) for pair, rows in self.transforms.items()}
        for (parent, child), rows in joined_chains(edges).items():
            names = ("time [s]", *_XYZ, *_QUATERNION)
            self.columns[f"{parent} to {child}"] = dict(zip(names, rows.T))
        for called, columns in self.columns.items():
            rows = len(columns["time [s]"])
            if rows >= _FEWEST_ROWS:
                cells = {
                    _prefixed(called, name): np.array(values) for name, values in columns.items()
                }
                made.append(RawTable(f"{file}, {called}", cells, np.arange(1, rows + 1)))
        return tuple(made)


def _prefixed(called: str, name: str) -> str:
    """Name of a column: that of the topic in front where the column alone says only its axis."""
    return f"{called} {name}" if name in _XYZ or name in _QUATERNION else name


def _pose_row(pose) -> dict[str, float]:
    """Columns of a Pose or Transform message."""
    place = pose.position if hasattr(pose, "position") else pose.translation
    orientation = pose.orientation if hasattr(pose, "orientation") else pose.rotation
    return dict(
        zip(
            (*_XYZ, *_QUATERNION),
            (place.x, place.y, place.z, orientation.x, orientation.y, orientation.z, orientation.w),
        )
    )


def _time(message, default: float) -> float:
    """Seconds of the header's stamp; of the recording where the header has none."""
    stamp = message.header.stamp
    nanoseconds = stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsec
    seconds = stamp.sec + 1e-9 * nanoseconds
    return seconds if seconds > 0 else default


def _pixels(message) -> np.ndarray | None:
    """Grey or BGR pixels of an Image or CompressedImage message; None for encodings that are not read."""
    import cv2

    if hasattr(message, "format"):
        return cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_UNCHANGED)
    depth = {
        "mono8": (np.uint8, 1),
        "8UC1": (np.uint8, 1),
        "mono16": (np.uint16, 1),
        "16UC1": (np.uint16, 1),
    }
    depth |= {"rgb8": (np.uint8, 3), "bgr8": (np.uint8, 3), "8UC3": (np.uint8, 3)}
    if message.encoding not in depth:
        return None
    kind, channels = depth[message.encoding]
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    used = np.ascontiguousarray(rows[:, : message.width * channels * np.dtype(kind).itemsize])
    pixels = used.view(kind).reshape(message.height, message.width, channels)
    if message.is_bigendian and kind is np.uint16:
        pixels = pixels.byteswap()
    if message.encoding == "rgb8":
        pixels = pixels[:, :, ::-1]
    return pixels[:, :, 0] if channels == 1 else pixels
