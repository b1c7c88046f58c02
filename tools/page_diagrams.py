"""Diagrams on pages of docs/: boxes and frames whose content is read from the code."""

import textwrap
import tomllib
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
BLUE, ORANGE, GREY = "#1565c0", "#e07b00", "#607d8b"


class Canvas:
    """A figure in units of inches, with boxes and arrows."""

    def __init__(self, width: float, height: float):
        self.figure = Figure(figsize=(width, height), facecolor="white")
        self.axes = self.figure.add_axes((0, 0, 1, 1))
        self.axes.set(xlim=(0, width), ylim=(0, height))
        self.axes.axis("off")

    def box(self, x, y, width, height, title, lines=(), colour=BLUE) -> None:
        """A box with its lower left corner at x, y; a bold title and lines of text."""
        style = "round,pad=0,rounding_size=0.08"
        patch = FancyBboxPatch((x, y), width, height, boxstyle=style, fc="white", ec=colour, lw=1.4)
        self.axes.add_patch(patch)
        centre = x + width / 2
        top = y + height - 0.2 if lines else y + height / 2
        words = dict(ha="center", va="center")
        self.axes.text(centre, top, title, weight="bold", size=9.5, color=colour, **words)
        self.axes.text(centre, top - 0.18, "\n".join(lines), ha="center", va="top", size=8)

    def arrow(self, start, end, text="") -> None:
        """An arrow from start to end, with a text at its middle."""
        look = dict(arrowstyle="-|>", color=GREY, lw=1.3, shrinkA=0, shrinkB=0)
        self.axes.annotate("", xy=end, xytext=start, arrowprops=look)
        middle = (np.asarray(start) + np.asarray(end)) / 2
        self.axes.text(*(middle + [0, 0.1]), text, ha="center", va="bottom", size=8, color=GREY)

    def save(self, name: str) -> None:
        """The figure as docs/images/NAME.png."""
        self.figure.savefig(IMAGES / f"{name}.png", dpi=110)


def ports() -> None:
    """The two measuring chains, with the ports at which an effect may act."""
    canvas = Canvas(10, 3.3)
    _chain(canvas, 2.05, "arm", _ARM_CHAIN, _by_port(_robot_effects()))
    _chain(canvas, 0.35, "scanner", _SCANNER_CHAIN, _by_port(_sensor_effects()))
    canvas.save("ports")


_ARM_CHAIN = (
    ("joint readings", "joint"),
    ("links", "geometry"),
    ("loads", "mass"),
    ("frames", "frame"),
    ("sensor", "sensor"),
    ("point", "target"),
)
_SCANNER_CHAIN = (
    ("pixel", "pixel"),
    ("ray", "ray"),
    ("mirror", "mirror"),
    ("light plane", "plane"),
    ("point", "point"),
    ("board, ball", "target"),
)


def _chain(canvas: Canvas, y: float, name: str, chain, effects: dict) -> None:
    canvas.axes.text(0.1, y + 0.4, name, weight="bold", size=11, va="center")
    for k, (title, port) in enumerate(chain):
        x = 1 + 1.52 * k
        count = len(effects[port])
        lines = [f"port {port}", f"{count} effect{'s' if count != 1 else ''}"]
        canvas.box(x, y, 1.22, 0.85, title, lines)
        if k:
            canvas.arrow((x - 0.3, y + 0.42), (x, y + 0.42))


def effects() -> None:
    """Every effect under its port."""
    arm, scanner = _by_port(_robot_effects()), _by_port(_sensor_effects())
    lower = _depth(scanner)
    canvas = Canvas(11, _depth(arm) + lower + 0.1)
    _columns(canvas, _depth(arm) + lower, "arm", arm)
    _columns(canvas, lower, "scanner", scanner)
    canvas.save("effects")


COLUMNS, GAP = 5, 0.12


def _depth(effects: dict) -> float:
    """Height that the ports take in columns, with their heading."""
    return 0.45 + max(bottom for *_, bottom in _placed(effects))


def _placed(effects: dict) -> list[tuple[str, int, float, float]]:
    """Port, column, and distances of its upper and lower edge from the top; long ports first, each in the
    shortest column."""
    filled = [0.0] * COLUMNS
    rows = []
    for port in sorted(effects, key=lambda port: -len(effects[port])):
        column = filled.index(min(filled))
        height = 0.42 + 0.14 * len(effects[port])
        rows.append((port, column, filled[column], filled[column] + height))
        filled[column] += height + GAP
    return rows


def _columns(canvas: Canvas, top: float, name: str, effects: dict) -> None:
    """Ports of one chain in columns below a heading at `top`."""
    canvas.axes.text(0.15, top - 0.2, f"Ports of the {name}", weight="bold", size=11)
    for port, column, upper, lower in _placed(effects):
        y = top - 0.32 - lower
        canvas.box(0.15 + 2.17 * column, y, 2.05, lower - upper, port, effects[port])


def _robot_effects():
    from robot_model.effects import CATALOGUE

    return CATALOGUE


def _sensor_effects():
    from sensors.effects import CATALOGUE

    return CATALOGUE


def _by_port(catalogue) -> dict[str, list[str]]:
    found = defaultdict(list)
    for name, kind in catalogue.items():
        found[kind.port].append(name)
    return found


def layers() -> None:
    """The layers of the packages, as lint-imports checks them."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    contracts = tomllib.loads(text)["tool"]["importlinter"]["contracts"]
    rows = next(one["layers"] for one in contracts if one["type"] == "layers")
    canvas = Canvas(7.2, 0.44 * len(rows) + 0.5)
    for k, row in enumerate(rows):
        y = 0.44 * (len(rows) - 1 - k) + 0.15
        names = [name.strip() for name in row.split("|")]
        width = 4.2 / len(names)
        for j, name in enumerate(names):
            canvas.box(0.2 + j * width, y, width - 0.06, 0.36, name)
    packages = ("sensors", "robot_model", "datasets")
    for k, name in enumerate(packages):
        canvas.box(4.95, 0.59 + 0.44 * k, 1.9, 0.36, name, colour=ORANGE)
    canvas.axes.text(0.2, canvas.axes.get_ylim()[1] - 0.3, "workbench", weight="bold", size=11)
    said = "A row may import\nthe rows below it.\n\nThese three import\nonly workbench.core\nand datasets.recording."
    canvas.axes.text(4.95, 2.1, said, size=9, va="bottom")
    canvas.save("layers")


def row_of_steps(canvas, steps, width: float, bottom: float, emphasised: str = "") -> None:
    """Boxes (title, text) from left to right with arrows between; that of the title `emphasised` is orange."""
    gap, height = 0.26, 1.1
    middle = bottom + height / 2
    for k, (title, text) in enumerate(steps):
        x = 0.12 + (width + gap) * k
        colour = ORANGE if title == emphasised else BLUE
        canvas.box(x, bottom, width, height, title, text.splitlines(), colour)
        if k:
            canvas.arrow((x - gap, middle), (x, middle))


def blind_benchmark() -> None:
    """The steps of the blind benchmark, in order."""
    steps = (
        ("simulator", "MuJoCo or ray\ntracer; plants\nan effect"),
        ("truth", "stored; its\nSHA-256 is\npublished"),
        ("recording", "readings and\nmeasurements,\nno truth"),
        ("diagnosis", "sees the\nrecording alone;\nfile access watched"),
        ("score", "truth is read,\nfixed rules"),
        ("scoreboard", "found, missed,\nwrong name,\nwith intervals"),
    )
    canvas = Canvas(10.6, 1.5)
    row_of_steps(canvas, steps, 1.5, 0.2, emphasised="truth")
    canvas.save("blind-benchmark")


def search_steps() -> None:
    """The steps of the diagnosis."""
    steps = (
        ("calibrate", "baseline: geometry,\nor --baseline"),
        ("project", "residual and effects,\nwithout what the\nbaseline absorbs"),
        ("search", "add, drop, exchange\nterms: largest\nlog posterior"),
        ("noise", "stated, repeats,\nheteroscedastic,\nrandom effects"),
        ("validate", "nested cross-\nvalidation: whole\nsearch in each fold"),
        ("answer", "verdict, confounded\neffects, next\nexperiment"),
    )
    canvas = Canvas(11.2, 1.9)
    row_of_steps(canvas, steps, 1.6, 0.6)
    again = dict(arrowstyle="-|>", color=ORANGE, lw=1.3, connectionstyle="arc3,rad=-0.35")
    canvas.axes.annotate("", xy=(4.6, 0.58), xytext=(6.5, 0.58), arrowprops=again)
    canvas.axes.text(5.55, 0.02, "until the set stays the same", ha="center", size=8, color=ORANGE)
    canvas.save("search-steps")


def frames() -> None:
    """Frames and terms of a measured arm: the ABB IRB 120 of the project, from the side."""
    from robot_model import load_robot
    from robot_model.chain import forward

    robot = load_robot("abb_irb120")
    joints = np.deg2rad([[0.0], [25], [5], [0], [40], [0]])
    made = forward(robot, joints, links=True)
    x, z = _side_view(made)
    figure = Figure(figsize=(8.6, 4.6), facecolor="white", layout="constrained")
    axes = figure.add_subplot()
    axes.plot(x, z, "-o", color=GREY, lw=5, ms=9, mfc="white", mec=BLUE, mew=2)
    _label_frames(axes, x, z)
    axes.set(
        xlabel="x of the base frame (mm)",
        ylabel="z (mm)",
        aspect="equal",
        xlim=(-150, 1350),
        ylim=(-60, 680),
    )
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(IMAGES / "frames.png", dpi=110)


def _side_view(made) -> tuple[np.ndarray, np.ndarray]:
    """x and z of base and frames 1 to J, mm."""
    origins = [np.zeros(3), *(np.asarray(o)[:, 0] for o in made.origin)]
    points = np.array(origins)
    return points[:, 0], points[:, 2]


def _label_frames(axes, x, z) -> None:
    target = (x[-1] + 130, z[-1] - 130)
    tracker = (950, 120)
    axes.plot(*target, "*", ms=14, color=ORANGE)
    axes.plot(*tracker, "s", ms=12, color=ORANGE)
    axes.plot([tracker[0], target[0]], [tracker[1], target[1]], ":", color=ORANGE)
    axes.plot([x[-1], target[0]], [z[-1], target[1]], "--", color=GREY)
    note = dict(textcoords="offset points", size=9)
    axes.annotate("base frame (frame 0)", (x[0], z[0]), xytext=(14, -4), **note)
    axes.annotate("flange frame", (x[-1], z[-1]), xytext=(12, 6), **note)
    axes.annotate(
        "reflector: its position in the\nflange frame is the tool", target, xytext=(12, 4), **note
    )
    axes.annotate("instrument: measures\nexternal-point", tracker, xytext=(12, -8), **note)
    middle = (x[2] / 2 + x[3] / 2, z[2] / 2 + z[3] / 2)
    axes.annotate("link", middle, xytext=(-40, 4), **note)
    axes.annotate("joint: reading q, zero offset theta", (x[1], z[1]), xytext=(14, -4), **note)


def files() -> None:
    """Files that a person writes, with the number of their keys, and the commands that read them."""
    import schema_page

    canvas = Canvas(9.2, 3.1)
    for k, file in enumerate(schema_page.files()):
        column, row = k % 3, k // 3
        keys = len(list(schema_page._keys(file.schema, file.schema.get("$defs", {}))))
        words = textwrap.wrap(file.purpose.replace("`", ""), 32)
        x, y = 0.15 + 3.02 * column, 2.15 - 1.0 * row
        canvas.box(x, y, 2.85, 0.87, file.name, [*words, f"{keys} keys"])
    canvas.save("files")


DIAGRAMS: dict[str, Callable[[], None]] = {
    "ports": ports,
    "effects": effects,
    "layers": layers,
    "blind-benchmark": blind_benchmark,
    "search-steps": search_steps,
    "frames": frames,
    "files": files,
}
