"""Attribution for arms that differ from their simulation; `python tools/study_differences.py` writes the page.

Each scene is an arm that differs from its simulation in parameters, noise, physics, or in several of them. The truth
is MuJoCo's (`datasets.makers.planted`). The recording is diagnosed against the simulation, the corrected model is
exported as MJCF, and MuJoCo runs the exported file at poses that the recording does not have. One row a scene is kept
in docs/studies/differences.csv, and a run goes on where an earlier one stopped. Each population of the page was run
once, by the code of its day. About half an hour on one core.

Seeds that no run has seen, scenes with differences in parameters or physics alone, in a table of their own:

    python tools/study_differences.py --count 30 --first-seed 880100 --differences-alone --table alone.csv
"""

import argparse
import csv
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from datasets.makers import planted  # noqa: E402
from robot_model import load_robot  # noqa: E402
from workbench.core.rigid import rotation_matrix  # noqa: E402
from workbench.explanation.answer import diagnose  # noqa: E402
from workbench.explanation.output.corrected_model import write_model  # noqa: E402
from workbench.files.exports.mjcf import control_terms, mjcf  # noqa: E402
from workbench.files.exports.python import python_module  # noqa: E402
from workbench.files.solution_file import CalibratedArm, read_solution  # noqa: E402

TABLE = ROOT / "docs" / "studies" / "differences.csv"
PAGE = TABLE.with_suffix(".md")
POPULATIONS = {1126000: 57, 2126000: 60, 3126000: 60}
"""First seed and number of scenes of each population of the page, in the order in which they were run."""
SCENES, FIRST_SEED = 60, 4126000  # of another population
UNSEEN = 150
# parameters, physics, noise that differ, in turn: each alone and every combination
COMBINATIONS = (
    (1, 0, False),
    (0, 1, False),
    (0, 0, True),
    (1, 1, False),
    (2, 0, True),
    (0, 2, True),
    (1, 2, False),
    (2, 1, True),
    (0, 3, False),
    (0, 0, False),
)
_NOISE_LEVEL = 1e-3  # of the test that the statement of the noise is right


@dataclass(frozen=True)
class Scene:
    """What was planted and what was found: names joined by a space, factors of the noise, prediction over noise."""

    seed: int
    parameters: str
    found_parameters: str
    physics: str
    found_physics: str
    factor: float
    found_factor: float
    noise_is_named: bool
    prediction: float

    @property
    def wrong_names(self) -> list[str]:
        """Parameters and effects that were named and are not there."""
        there = set(self.parameters.split()) | set(self.physics.split())
        named = (*self.found_parameters.split(), *self.found_physics.split())
        return [name for name in named if not _right(name, there)]

    @property
    def missed(self) -> list[str]:
        """What is there and was not named."""
        there = [*self.parameters.split(), *self.physics.split()]
        found = (*self.found_parameters.split(), *self.found_physics.split())
        named = {one for name in found for one in _right(name, set(there))}
        return [name for name in there if name not in named]

    @property
    def is_right(self) -> bool:
        """Whether everything was attributed as it is: parameters, physics, and whether the noise is as stated."""
        noise = self.noise_is_named == (self.factor != 1.0)
        return not self.wrong_names and not self.missed and noise


def _right(name: str, there: set[str]) -> set[str]:
    """What is there of a name with alternatives: an alternative of several parameters counts where all are there."""
    sets = [set(one.split("+")) for one in name.split("|")]
    return set().union(*(one for one in sets if one <= there))


def nominal_arm(robot_keys) -> CalibratedArm:
    """The arm of a robot file as a simulation holds it: rigid, with the lengths of its data sheet."""
    robot = load_robot(dict(robot_keys))
    names = ("theta", "d", "a", "alpha", "beta")
    values = {
        f"joint-{k + 1}.{name}{k + 1}": robot.geometry[k, c]
        for k in range(robot.joints)
        for c, name in enumerate(names)
    }
    nothing = np.zeros((0, 0))
    return CalibratedArm(robot, (), values, (), nothing, robot.payload_com, 0.0, True, "", {})


def scene(seed: int, combination) -> Scene:
    """Make, diagnose, export and run one scene."""
    truth = planted.make(seed, *combination)
    recording = truth.made.recording()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        simulation = folder / "simulation.xml"
        simulation.write_text(mjcf(nominal_arm(truth.made.robot)))
        made = diagnose(recording, simulation=simulation)
        write_model(made, recording, folder)
        found = made.as_json()["differences"]
        prediction = predicted(truth, read_solution(folder))
    parameters = ["|".join(_names(row)) for row in found["parameters"]]
    physics = [f"{one['where']}.{one['effect']}" for one in found["physics"]]
    return Scene(
        seed,
        " ".join(truth.parameters),
        " ".join(parameters),
        " ".join(f"{where}.{effect}" for effect, where in truth.physics),
        " ".join(physics),
        truth.factor,
        found["noise"]["factor"],
        found["noise"]["p_value"] < _NOISE_LEVEL,
        prediction,
    )


def _names(row) -> list[str]:
    """The parameter and what may stand in its place; the members of a set are joined by "+"."""
    others = [other.replace(" + ", "+") for other in row["confounded_with"]]
    return [f"{row['where']}.{row['name']}", *others]


def predicted(truth, arm: CalibratedArm) -> float:
    """RMS 3-D distance between unseen measurements and the exported model in MuJoCo, over the RMS noise."""
    from mujoco_statics import flange_at_rest

    joints, approach, payload = truth.unseen(UNSEEN)
    readings = np.deg2rad(joints)
    columns = {f"approach{k}": side for k, side in enumerate(approach.T, 1)}
    after = 10.0 * len(truth.made.columns["sample"])
    columns |= {"payload_kg": payload, "time_s": np.full(UNSEEN, after)}
    columns |= {"row": np.full(UNSEEN, float(len(truth.made.columns["sample"])))}
    if control_terms(arm):
        module: dict = {"__name__": "exported"}
        exec(python_module(arm), module)
        readings = module["servo_targets"](joints, columns)
    flange = flange_at_rest(mjcf(arm), readings, payload)
    reflector = [arm.values[f"tool.reflector1_{axis}"] for axis in "xyz"]
    base = np.array([arm.values[key] for key in arm.values if key.startswith("base.")][:6])
    in_root = flange[:, :3, :3] @ reflector + flange[:, :3, 3]
    found = in_root @ rotation_matrix(base[3:]).T + base[:3]
    sigma = truth.made.sigma_mm * truth.factor
    noise = np.random.default_rng([5, int(joints[0, 0] * 1e4) % 2**31]).normal(
        0, sigma, found.shape
    )
    measured = truth.true_points(joints, approach, payload) + noise
    return float(np.sqrt(((found - measured) ** 2).sum(1).mean() / (3 * sigma**2)))


def collect(count: int, table: Path, first: int, combinations=COMBINATIONS) -> list[Scene]:
    """All scenes, with seeds from `first` on and combinations in turn; those in the table are not computed again."""
    wanted = [(first + k, combinations[k % len(combinations)]) for k in range(count)]
    return _collected(wanted, table)


def published() -> list[Scene]:
    """The scenes of all populations; those in the table are not computed again."""
    wanted = [
        (first + k, COMBINATIONS[k % len(COMBINATIONS)])
        for first, count in POPULATIONS.items()
        for k in range(count)
    ]
    return _collected(wanted, TABLE)


def _collected(wanted, table: Path) -> list[Scene]:
    """Scenes of seeds with their combinations, a row of the table each."""
    rows = read(table)
    for seed, combination in wanted[len(rows) :]:
        rows.append(scene(seed, combination))
        write(rows, table)
        print(len(rows), rows[-1], rows[-1].wrong_names, rows[-1].missed, flush=True)
    return rows


def read(table: Path) -> list[Scene]:
    """Scenes of a table; none where there is no file."""
    if not table.is_file():
        return []
    kinds = {"seed": int, "factor": float, "found_factor": float, "prediction": float}
    kinds["noise_is_named"] = lambda text: text == "True"
    with table.open(encoding="utf-8", newline="") as file:
        return [
            Scene(**{k: kinds.get(k, str)(v) for k, v in row.items()})
            for row in csv.DictReader(file)
        ]


def write(rows: list[Scene], table: Path) -> None:
    """The table, a row a scene."""
    with table.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(vars(rows[0])), lineterminator="\n")
        writer.writeheader()
        writer.writerows(vars(row) for row in rows)


_PAGE = """# Parameters, noise and physics: attribution of simulated differences

{count} simulated arms differ from the simulation that is compared with them: in parameters of the geometry, in the
noise, in physics that the simulation does not contain, or in several of these. MuJoCo computes their poses
(`datasets/makers/planted.py`); it shares no code with the kinematics and statics of the workbench. There are three
robots (0.6, 0.7 and 2.7 m reach), 130 poses, a load that changes, and noise of 0.02 or 0.05 mm. Each recording is
diagnosed against the nominal simulation (`workbench diagnose REC --simulation nominal.xml`), the corrected model is
exported as MJCF, and MuJoCo runs the exported file at {unseen} poses that the recording does not contain. `python
tools/study_differences.py` writes this page; `differences.csv` has one row for each scene. The seeds of each
population were fixed before its run. The diagnosis was not developed on these scenes, and each was run once.

![Estimated noise factor over the planted one](../images/differences.png)

Effects are joint compliance, backlash, a transmission harmonic and a shift of a joint's zero. Link bending is not
among them: in MuJoCo's arm the mass of a link is beyond its flexure, in the equation of the workbench before it.

{figures}

| planted differences | scenes | attributed correctly | largest prediction over noise |
|---|---|---|---|
{rows}

Scenes that were attributed wrongly:

{faults}
{remark}"""
_AFTERWARDS = """
The causes of the three faults of the first population were removed before the second was run. In scene 1126028 two
samples next to the instant of the shift were called outliers, and the instant was 20 s late. In scenes 1126003 and
1126042 random structure (p = 0.008 and 0.007) was reported as unexplained.

In scenes 3126036 and 3126045 joint 3 has a harmonic of one cycle per revolution, and the poses cover 128 and 116
degrees of it. There it resembles an offset of the joint and a smooth curve. The diagnosis reports the curve, and the
offset as a parameter that differs. The Bayesian information criterion of all parameters and terms together is lower
by 2 and by 33 for the planted terms, since they need no parameter that differs from the simulation. The search for
terms does not use this: it estimates the geometry without the prior knowledge that most of it equals the simulation.
The table shows the result of each run.
"""


def page(rows: list[Scene]) -> str:
    """The page of these scenes."""
    is_published = rows[0].seed in POPULATIONS
    groups = [rows]
    if is_published:
        groups = [
            [row for row in rows if first <= row.seed < first + count]
            for first, count in POPULATIONS.items()
        ]
    values = {
        "count": len(rows),
        "unseen": UNSEEN,
        "figures": "\n".join(_figures(groups)),
        "rows": "\n".join(_by_kind(rows)),
        "faults": "\n".join(_fault(row) for row in rows if not row.is_right) or "- none",
        "remark": _AFTERWARDS if is_published else "",
    }
    return _PAGE.format(**values)


def _figures(groups: list[list[Scene]]):
    """Lines of the table of figures, a column a population."""
    heads = [f"seeds {own[0].seed} to {own[-1].seed}" for own in groups]
    columns = [_cells(own) for own in groups]
    yield f"| | {' | '.join(heads)} | criterion |"
    yield "|---|" + "---|" * (len(heads) + 1)
    for name, (_, criterion) in columns[0].items():
        yield f"| {name} | {' | '.join(column[name][0] for column in columns)} | {criterion} |"


def _cells(rows: list[Scene]) -> dict[str, tuple[str, str]]:
    """Name of a figure -> its text of one population, and its acceptance criterion."""
    some = [row for row in rows if row.parameters or row.physics]
    count, prediction = len(rows), np.array([row.prediction for row in rows])
    right = np.array([row.is_right for row in rows])
    factor = sum(abs(row.found_factor / row.factor - 1) < 0.1 for row in rows)
    near, near_some = int((prediction <= 1.1).sum()), sum(row.prediction <= 1.1 for row in some)
    first_wrong = sum(len(row.wrong_names) for row in some[:30])
    attributed = "scenes attributed correctly: parameters, physics, noise"
    exported = "exported model predicts unseen poses within 1.1 times the noise"
    return {
        attributed: (f"{right.sum()} of {count} ({right.mean():.1%})", "95 %"),
        "noise factor within 10 %": (f"{factor} of {count}", "all"),
        "scenes with a wrong finding": (f"{sum(bool(row.wrong_names) for row in rows)}", ""),
        "scenes in which a difference was missed": (f"{sum(bool(row.missed) for row in rows)}", ""),
        exported: (f"{near} of {count}", "27 of 30"),
        "the same, differences in parameters or physics": (
            f"{near_some} of {len(some)}",
            "27 of 30",
        ),
        "wrong findings in the first 30 of these": (f"{first_wrong}", "at most 1"),
        "prediction over noise: median": (f"{np.median(prediction):.3f}", ""),
        "prediction over noise: largest": (f"{prediction.max():.3f}", "1.1"),
    }


def _by_kind(rows: list[Scene]):
    """A line of the table for each combination of what was planted."""
    kinds: dict[str, list[Scene]] = {}
    for row in rows:
        parts = (row.parameters, row.factor != 1.0, row.physics)
        names = [n for n, there in zip(("parameters", "noise", "physics"), parts) if there]
        kinds.setdefault(" + ".join(names) or "nothing", []).append(row)
    for kind, members in sorted(kinds.items()):
        right = sum(row.is_right for row in members)
        largest = max(row.prediction for row in members)
        yield f"| {kind} | {len(members)} | {right} | {largest:.3f} |"


def _fault(row: Scene) -> str:
    said = [f"wrong: {', '.join(row.wrong_names)}"] if row.wrong_names else []
    said += [f"missed: {', '.join(row.missed)}"] if row.missed else []
    said += [] if said else [f"noise factor {row.factor:.2f}, found {row.found_factor:.2f}"]
    return f"- scene {row.seed}: {'; '.join(said)}"


def main() -> None:
    """Write the published page, or print the figures of another population."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=SCENES)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument(
        "--differences-alone", action="store_true", help="scenes with differences alone"
    )
    parser.add_argument("--table", type=Path)
    options = parser.parse_args()
    if options.table is None:
        PAGE.write_text(page(published()), encoding="utf-8")
        return
    combinations = [
        one for one in COMBINATIONS if not options.differences_alone or one[0] or one[1]
    ]
    scenes = collect(options.count, options.table, options.first_seed, combinations)
    sys.stdout.write(page(scenes))


if __name__ == "__main__":
    main()
