"""Sensitivity of the end of an arm to each kinematic parameter, and average significance index."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from robot_model.chain import forward
from robot_model.files.loading import builtin_robots, load_robot
from robot_model.measurements import end_recordings, samples_of
from robot_model.robot import Robot
from robot_model.state import sliding
from robot_model.system import geometry_free
from workbench.core.errors import InputError
from workbench.core.robot_files.robot_description import is_robot_file
from workbench.core.text.csv_text import csv_text
from workbench.machine.progress import paced

COLUMNS = ("theta", "d", "a", "alpha", "beta")
COMPONENTS = ("position", "x", "y", "z")
"""What is moved: the position of the flange (mm), then the unit vectors of its x, y and z axis."""


@dataclass(frozen=True)
class Significance:
    """`index` (P, 4) average significance of each parameter for place (mm) and axes, `sensitivity` (P, 4) the
    same per unit of the parameter for small changes (mm or 1 per mm or rad); `keys` (P,) of the parameters,
    `step_mm` and `step_rad` by which they were moved, at `points` configurations; `place` says which.
    """

    robot: Robot
    keys: tuple[str, ...]
    index: np.ndarray
    sensitivity: np.ndarray
    points: int
    step_mm: float
    step_rad: float
    place: str = "random configurations"

    def unseen(self) -> dict[str, list[str]]:
        """part -> keys of the parameters that do not move it at all."""
        small = 1e-9 * self.index.max(0)
        return {
            part: [k for k, v in zip(self.keys, self.index[:, c]) if v <= small[c]]
            for c, part in enumerate(COMPONENTS)
        }

    def as_json(self) -> dict:
        """The answer of `workbench significance`."""
        rows = list(map(_row, self.keys, self.index.tolist(), self.sensitivity.tolist()))
        return {
            "command": "significance",
            "robot": self.robot.name,
            "points": self.points,
            "step_mm": self.step_mm,
            "step_rad": self.step_rad,
            "configurations": self.place,
            "parameters": rows,
            "without_effect": self.unseen(),
        }


def significance(
    robot: Robot,
    points: int = 50,
    seed: int = 0,
    step_mm: float = 0.1,
    step_rad: float = 0.1,
    readings: np.ndarray | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Significance:
    """The average significance index of every parameter of the geometry, at random configurations.

    readings (n, R) rad, mm: draw from these, where a recording's own poses are asked about. progress: called with
    one line a parameter.

    Mathematics 2023, 11, 4802, eq. 8-10: the change of the end's place and axes by one parameter,
    projected on the whole change, in the mean over configurations drawn over the joints' ranges.
    Each parameter is moved alone, so that the projection is the length of the change. Ranges
    that the robot does not state are taken as half a turn each way.
    """
    if readings is None:
        variables = _drawn(robot, points, seed)
    else:
        variables = _random_variables(robot, readings, points, seed)
    keys = tuple(geometry_free(robot))
    places = [
        (int(key[6 : key.index(".")]) - 1, COLUMNS.index(key.split(".")[1].rstrip("0123456789")))
        for key in keys
    ]
    steps = np.array([step_mm if COLUMNS[c] in ("d", "a") else step_rad for _, c in places])
    tick = paced(progress, "parameter")
    moved = []
    for done, (place, step) in enumerate(zip(places, steps), 1):
        moved.append([_moved(robot, variables, *place, size) for size in (step, 1e-6)])
        tick(done, len(places))
    index, small = np.array(moved).swapaxes(0, 1)
    small = small / 1e-6
    place = "random configurations" if readings is None else "of its recorded configurations"
    return Significance(robot, keys, index, small, variables.shape[1], step_mm, step_rad, place)


def robot_called(name: str) -> tuple[Robot, np.ndarray | None]:
    """A robot, and the readings (n, R) of the recording that it was taken from, None where it was taken from none.

    name: a recording (folder or known name), a robot.toml, URDF or MJCF file, or a robot that comes with the workbench.
    Raises InputError.
    """
    import datasets
    from datasets.reading import bundled

    known = {row["name"] for row in datasets.listing()} | set(bundled())
    if Path(name).name == "recording.toml":
        folder = Path(name).parent
    else:
        folder = Path(name)
    if not folder.is_dir() and name.partition(":")[0] not in known:
        return _robot(name, known), None
    recording = datasets.read(name)
    if not recording.robot or not recording.joints.size:
        raise InputError(
            f"{name}: expected a recording with a robot and joint readings q1_deg ..., found "
            f"{recording.measures} without; name a robot, or another recording"
        )
    robot = load_robot(recording.robot, f"robot of {recording.name}")
    readings = np.concatenate([end.joints for end in end_recordings(samples_of(recording))])
    if readings.shape[1] != robot.mixing.shape[1]:
        raise InputError(
            f"{name}: expected {robot.mixing.shape[1]} joint readings as {robot.name} has, found "
            f"{readings.shape[1]}; correct samples.csv or robot.toml"
        )
    return robot, readings


def _robot(name, recordings):
    """The robot of a file or of a name; InputError that also says which recordings there are."""
    if not is_robot_file(name) and name not in builtin_robots():
        raise InputError(
            f"{name}: expected a robot ({', '.join(builtin_robots())}), a robot.toml, URDF or MJCF file, or a "
            f"recording ({', '.join(sorted(recordings))}, or a folder), found none of these; correct it"
        )
    return load_robot(name)


def _row(key: str, index: list[float], sensitivity: list[float]) -> dict:
    """A parameter with its index and its sensitivity by component."""
    row = {"parameter": key}
    row |= {f"index_{name}": value for name, value in zip(COMPONENTS, index)}
    return row | {f"sensitivity_{name}": value for name, value in zip(COMPONENTS, sensitivity)}


def _drawn(robot, points, seed):
    """(J, points) joint variables of readings drawn over their ranges; a slide half a metre where none is stated."""
    half = np.where(sliding(robot), 250.0, np.pi)[:, None] * [-1, 1]
    low, high = np.where(np.isfinite(robot.limits), robot.limits, half).T
    readings = np.random.default_rng(seed).uniform(low, high, (points, len(low)))
    return robot.mixing @ readings.T


def _random_variables(robot, readings, points, seed):
    """(J, at most points) joint variables of recorded readings, each row once."""
    chosen = np.random.default_rng(seed).permutation(len(readings))[:points]
    return robot.mixing @ readings[chosen].T


def _moved(robot, variables, joint, column, step):
    """(4,) mean change of place (mm) and of the three axes when one parameter is moved by `step`."""
    geometry = np.array(robot.geometry, float)
    before = forward(robot, variables, geometry)
    geometry[joint, column] += step
    after = forward(robot, variables, geometry)
    changes = [
        after.end_origin - before.end_origin,
        *(a - b for a, b in zip(after.end, before.end)),
    ]
    return [float(np.sqrt((change**2).sum(0)).mean()) for change in changes]


def save(found: Significance, folder: Path) -> None:
    """Write table.csv and significance.png."""
    rows = found.as_json()["parameters"]
    text = csv_text(rows[0], [row.values() for row in rows])
    (folder / "table.csv").write_text(text, encoding="utf-8")
    image(found).savefig(folder / "significance.png", dpi=130)


def image(found: Significance):
    """A matplotlib figure: four charts, a bar a parameter, crosses where there is no effect at all."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6.4), facecolor="white", layout="constrained")
    names = [key.split(".")[1] for key in found.keys]
    unseen = found.unseen()
    titles = ("position of the flange", "x axis (NP)", "y axis (OP)", "z axis")
    charts = figure.subplots(2, 2, sharex=True).ravel()
    for axes, part, title, column in zip(charts, COMPONENTS, titles, found.index.T):
        none = np.isin(found.keys, unseen[part])
        axes.bar(names, column, color="#1f83c4", width=0.7)
        marks = {"marker": "x", "s": 26, "color": "#d9730d", "zorder": 3, "label": "no effect"}
        axes.scatter(np.flatnonzero(none), np.zeros(none.sum()), **marks)
        axes.set_title(title, size=10.5)
        axes.set_ylabel("displacement (mm)" if part == "position" else "change of unit vector (1)")
        if part == "position":  # tenths of a millimetre next to tens
            axes.set_yscale("log")
            axes.set_ylim(0.3 * min(column[~none]), None)
            axes.collections[-1].set_offsets(
                [(k, 0.34 * min(column[~none])) for k in np.flatnonzero(none)]
            )
        axes.tick_params("x", rotation=90, labelsize=8)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", alpha=0.25)
    charts[1].legend(frameon=False, loc="lower right", bbox_to_anchor=(1, 0.98))
    figure.suptitle(
        f"{found.robot.name}: average significance of {found.step_mm:g} mm or {found.step_rad:g} rad, "
        f"{found.points} {found.place}",
        size=11.5,
    )
    return figure
