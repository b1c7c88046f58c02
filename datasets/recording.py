"""One recording in memory: columns as they stand in the file, and the arrays that a solve needs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from datasets.errors import InputError, complaint
from datasets.samples.columns import BOOKKEEPING, FLANGE, MEASURED, OTHER, SIGMAS, joint_columns
from workbench.core.rigid import transform

SECTION = "scan_section_mm"
ROOT = tuple(f"scan_root_{a}{b}" for a in "xyz" for b in "xyz")
SCATTER = "scan_scatter_mm"
SCAN = frozenset({SECTION, SCATTER, *ROOT})
"""Columns of a scan whose points are one sample, in memory only: see `robot_model.measurements.ball_scan`."""


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """Samples of one arm, all in file units (deg, mm); the properties are in rad and mm.

    Examples:
        >>> recording = wb.load_example("elastic-arm")
        >>> recording.measures, recording.n, recording.points.shape
        ('ball-centre', 300, (300, 3))
        >>> joints_deg = np.rad2deg(recording.joints)
        >>> made = wb.Recording.from_arrays(recording.robot, joints_deg, recording.points, sigma_mm=0.02)
        >>> made.select(np.arange(10)).n
        10
    """

    measures: str
    """What a sample is: "ball-centre", "external-point", … (`datasets.samples.columns.KINDS`)."""
    columns: Mapping[str, np.ndarray]
    """Every column by its file name, (n,) float64, or (n,) str for text columns."""
    robot: Mapping
    """Keys of robot.toml, or {"builtin": name}, or {"urdf": path, "joints": [...], "tip": link}."""
    title: str = ""
    """One line that says what was measured."""
    sigma_mm: float | None = None
    """1 sigma of one measured coordinate; None where unknown."""
    balls: Mapping[int, tuple[float, float, float, float]] = field(default_factory=dict)
    """artefact.csv: ball number -> x, y, z, radius in the artefact frame, mm."""
    images: Sequence[Mapping] = ()
    """Rows of images.csv; "image" is relative to `folder`."""
    board: Mapping | None = None
    """Keys of [board]; `fixed_to` is "tool" where the arm holds the board and the camera stands."""
    guess: Mapping = field(default_factory=dict)
    """Keys of [guess]: start values of the fit."""
    name: str = ""
    """Name of the recording, for messages."""
    folder: Path | None = None
    """Folder that it was read from; None for one in memory."""
    source: str = ""
    """Where the measurements are from."""
    licence: str = ""
    """Licence of the measurements."""
    sha256: str = ""
    """Of the files that the numbers were read from."""
    warnings: tuple[str, ...] = ()
    """Sentences on what is unusual and was accepted; every command that reads the recording repeats them."""
    group_names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Column of groups (reflector, pose, ...) -> its names in the file; name k stands for the number k + 1."""
    time_origin: float | str | None = None
    """The moment of time_s = 0: s of a numeric clock, or an ISO 8601 time stamp; None where it is unknown."""
    remarks: tuple[str, ...] = ()
    """Sentences of an import that the recording alone does not show; they are among the `warnings` once it is read."""
    is_resampled: bool = False
    """True where rows were drawn with replacement (bootstrap): equal rows then count as often as they were drawn."""

    def __repr__(self) -> str:
        robot = self.robot.get("builtin") or self.robot.get("name") or "no robot named"
        columns = ", ".join(self.columns)
        name = self.title or self.name or "recording"
        return f"<Recording {name}: {self.n} samples, {self.measures}, {robot}; columns {columns}>"

    @property
    def n(self) -> int:
        """Number of samples."""
        return len(next(iter(self.columns.values()))) if self.columns else 0

    @property
    def sample_ids(self) -> np.ndarray:
        """(n,) int, unique."""
        return self._integers("sample", np.arange(1, self.n + 1))

    @property
    def joints(self) -> np.ndarray:
        """(n, J) joint readings in order of the joint's number: rad, mm for a prismatic joint."""
        names = joint_columns(self.columns)
        scaled = [self.columns[c] * (1.0 if c.endswith("_mm") else np.pi / 180) for c in names]
        return np.stack(scaled, axis=1) if scaled else np.empty((self.n, 0))

    @property
    def flange(self) -> np.ndarray | None:
        """(n, 4, 4) T_base_flange as recorded, mm; None where the recording holds joint readings or no arm."""
        if FLANGE[0] not in self.columns:
            return None
        from scipy.spatial.transform import Rotation

        x, y, z, qw, qx, qy, qz = (self.columns[c] for c in FLANGE)
        rotation = Rotation.from_quat(np.stack([qx, qy, qz, qw], axis=1)).as_matrix()
        return transform(rotation, np.stack([x, y, z], axis=1))

    @property
    def points(self) -> np.ndarray:
        """(n, 3) measured points, mm, in the sensor's or the external instrument's frame.

        Raises InputError where the recording holds no points (touch-point, laser-spot, …).
        """
        if "x_mm" not in self.columns:
            raise complaint(
                f"{self.name or 'recording'}, columns x_mm, y_mm, z_mm",
                "measured points",
                f"none in a {self.measures} recording",
                "use a command for this kind of recording or add the columns",
            )
        return np.stack([self.columns[c] for c in ("x_mm", "y_mm", "z_mm")], axis=1)

    @property
    def sigma(self) -> np.ndarray | None:
        """(n,) 1 sigma of one coordinate, mm: the row's own, else the recording's, else None.

        The row's own is `sigma_mm`, else the root mean square of `sigma_x_mm`, `sigma_y_mm` and `sigma_z_mm`.
        """
        if "sigma_mm" in self.columns:
            return self.columns["sigma_mm"]
        if all(name in self.columns for name in SIGMAS):
            return np.sqrt(np.mean([self.columns[name] ** 2 for name in SIGMAS], axis=0))
        return None if self.sigma_mm is None else np.full(self.n, float(self.sigma_mm))

    @property
    def moving(self) -> np.ndarray:
        """(n,) bool: rows that enter a kinematic fit (`fixed_to` is "tool")."""
        fixed = self.columns.get("fixed_to")
        return np.ones(self.n, bool) if fixed is None else fixed == "tool"

    @property
    def reflector(self) -> np.ndarray:
        """(n,) int: which reflector, 1 where the file does not say."""
        return self._integers("reflector", np.ones(self.n, int))

    @property
    def ball(self) -> np.ndarray:
        """(n,) int: which ball of the artefact, 1 where the file does not say."""
        return self._integers("ball", np.ones(self.n, int))

    @cached_property
    def poses(self) -> np.ndarray:
        """(n,) int labels 0, 1, …: rows with one `pose`, or with one `repeat`, share a label.

        Rows that are linked through others share it too, so that a split by label never parts
        repeats of one pose; so do rows whose joint readings agree.
        """
        # readings that agree to 1e-4 rad (1e-4 mm) are one commanded pose, whatever the columns say
        second = [
            c
            for c in self.columns
            if c.startswith(OTHER) and joint_columns([c.removeprefix(OTHER)])
        ]
        readings = np.column_stack([self.joints, *(self.columns[c] for c in second)])
        if FLANGE[0] in self.columns and not readings.size:
            readings = np.stack([self.columns[c] for c in FLANGE], axis=1)
        posture = _labels_of_rows(readings.round(4))
        links = [self.columns[c] for c in ("pose", "repeat") if c in self.columns]
        return _linked([posture if readings.size else np.arange(self.n), *links])

    @property
    def covariates(self) -> dict[str, np.ndarray]:
        """Numeric columns that are neither joints, nor measured, nor bookkeeping; file units."""
        known = BOOKKEEPING | MEASURED | SCAN | set(joint_columns(self.columns))
        return {k: v for k, v in self.columns.items() if k not in known and v.dtype.kind == "f"}

    @classmethod
    def from_arrays(
        cls,
        robot: str | Mapping,
        joints_deg: ArrayLike,
        points_mm: ArrayLike,
        sigma_mm: float | None = None,
        **columns: ArrayLike,
    ) -> "Recording":
        """A recording of points or poses that an external instrument measured, from arrays in memory.

        Args:
            robot: Name of a built-in robot, path of a robot.toml or URDF, or the keys of a robot.toml.
            joints_deg: (n, J) joint readings, deg (mm for a prismatic joint).
            points_mm: (n, 3) measured points in the frame of the instrument, mm.
            sigma_mm: 1 sigma of one measured coordinate, mm; None where unknown.
            **more: `quaternions` (n, 4) w x y z where poses are measured, and further columns of samples.csv, each
                (n,): `reflector` (numbers or names), `payload_kg`, `temperature_c`, `time_s`, ...

        Raises:
            InputError: Shapes do not agree, the robot cannot be read, or a value cannot be a measurement; the
                sentence names row (from 0) and column.
        """
        from datasets.from_arrays import from_arrays

        return from_arrays(cls, robot, joints_deg, points_mm, sigma_mm, **columns)

    def save(self, folder: str | Path) -> Path:
        """Write the recording into a new folder, which `read` and all commands accept, and return the folder.

        Raises:
            InputError: The folder exists and holds files.
        """
        from datasets.formats.recording1_writer import write

        folder = Path(folder)
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(
                f"{folder}: expected a new or empty folder, found files; name another."
            )
        write(self, folder)
        return folder

    def select(self, rows) -> "Recording":
        """The same recording with only `rows`: a (n,) bool mask, or indices in the wanted order."""
        rows = np.asarray(rows)
        return replace(self, columns={k: v[rows] for k, v in self.columns.items()})

    def without_duplicates(self) -> "Recording":
        """Every measurement once: exact copies of an earlier row are left out and named in `warnings`.

        The recording as it is where rows were drawn with replacement.
        """
        if self.is_resampled:
            return self
        from datasets.samples.duplicates import without_duplicates

        return without_duplicates(self)

    def _integers(self, column: str, default: np.ndarray) -> np.ndarray:
        return self.columns[column].astype(int) if column in self.columns else default


def _labels_of_rows(rows: np.ndarray) -> np.ndarray:
    """(n,) number of each row (n, k) among the different ones, in ascending order of the rows.

    The labels are those of `np.unique(rows, axis=0)`, which sorts whole rows and takes five times as long.
    """
    if not rows.size:
        return np.zeros(len(rows), int)
    order = np.lexsort(rows.T[::-1])
    ascending = rows[order]
    is_new = np.append(False, (ascending[1:] != ascending[:-1]).any(axis=1))
    labels = np.empty(len(rows), int)
    labels[order] = np.cumsum(is_new)
    return labels


def _linked(keys: list[np.ndarray]) -> np.ndarray:
    """(n,) labels of the connected rows, where rows with one value of any key are connected."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n, start, rows, nodes = len(keys[0]), len(keys[0]), [], []
    for key in keys:
        values, group = np.unique(key, return_inverse=True)
        rows.append(np.arange(n))
        nodes.append(start + group)
        start += len(values)
    row, node = np.concatenate(rows), np.concatenate(nodes)
    graph = coo_array((np.ones(len(row)), (row, node)), shape=(start, start))
    labels = connected_components(graph, directed=False)[1][:n]
    return np.unique(labels, return_inverse=True)[1]
