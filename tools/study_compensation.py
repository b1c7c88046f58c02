"""Compensation from a diagnosis, executed by MuJoCo; `python tools/study_compensation.py` writes the page.

Each scene is an arm that differs from its nominal file (`datasets.makers.planted`). Its recording is diagnosed, targets
are compensated with the run of the diagnosis, and the true arm is sent to the corrected readings. The error of the
measured point in the instrument's frame is compared with the uncertainty that the model predicts of it. The populations
are fixed: `SCENES` seeds from each of `FIRST_SEEDS` on, with what is planted in turn. One row a scene is kept in
docs/studies/compensation.csv, and a run goes on where an earlier one stopped. About 20 minutes on one core.
"""

import csv
import json
import sys
import tempfile
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from datasets.makers import planted  # noqa: E402
from robot_model import load_robot  # noqa: E402
from workbench.core.rigid import rotation_matrix  # noqa: E402
from workbench.core.solution import Stage  # noqa: E402
from workbench.explanation.answer import diagnose  # noqa: E402
from workbench.explanation.output.corrected_model import write_model  # noqa: E402
from workbench.files.considered import considered_arms, is_evaluable  # noqa: E402
from workbench.files.solution_file import (  # noqa: E402
    CalibratedArm,
    read_solution,
    robot_keys,
    solution_keys,
)
from workbench.fitting.calibration_plans.plans import geometry  # noqa: E402
from workbench.jobs.robot.calibrate import calibrate  # noqa: E402
from workbench.jobs.robot.compensation.compensate import (  # noqa: E402
    COVERAGE_FACTOR,
    compensate,
    model_at,
    nominal_poses,
)  # noqa: E402
from workbench.jobs.robot.compensation.point_uncertainty import position_derivative  # noqa: E402

TABLE = ROOT / "docs" / "studies" / "compensation.csv"
PAGE = TABLE.with_suffix(".md")
FIRST_SEEDS, SCENES, TARGETS = (5000, 64720, 83150, 770100, 940500, 2226000), 20, 60
KNOWN, KNOWN_TERMS = 940500, "terms known"
"""First seed of the population whose models have the planted terms, without a diagnosis, and its verdict."""
UNSEEN = 2226000
"""First seed of the population that was run when search and estimate were final."""
LIMIT = 1.2
"""Error over predicted uncertainty up to which the prediction is called right."""
_DEGREES = 360  # 130 poses, three coordinates, some thirty parameters
_DRAWS, _LARGEST = 20000, 100  # of the eigenvalues: a model has fewer parameters
# numbers of parameters and of effects that differ, and whether the noise is stated wrongly: in turn
COMBINATIONS = ((2, 1, False), (1, 2, False), (0, 1, False), (2, 0, False), (1, 3, False))


@dataclass(frozen=True)
class Executed:
    """RMS 3-D errors (mm) of the measured point at the targets, and the RMS uncertainty that the model predicts.

    `chance`: probability that the error of a right model with this covariance is above the limit, since all targets
    share some thirty estimated parameters. `covered`: share of targets whose error is within the expanded uncertainty.
    `planted` and `named`: effects with their places, joined by "; "; `verdict` of the diagnosis.
    """

    seed: int
    before: float
    after: float
    predicted: float
    chance: float
    covered: float
    planted: str
    named: str
    verdict: str

    @property
    def ratio(self) -> float:
        """Error after compensation over the predicted uncertainty."""
        return self.after / self.predicted

    @property
    def is_within(self) -> bool:
        """Whether the error is within the limit."""
        return self.ratio <= LIMIT


def execute(seed: int, combination) -> Executed:
    """Make, diagnose and compensate one scene, and send the true arm to the corrected readings."""
    truth = planted.make(seed, *combination)
    recording = truth.made.recording()
    with tempfile.TemporaryDirectory() as name:
        made = diagnose(recording)
        write_model(made, recording, Path(name))
        arm = read_solution(Path(name))
    named = "; ".join(f"{term.finding.effect} at {term.finding.where}" for term in made.terms)
    return Executed(seed, *figures_of(truth, arm), _planted(truth), named, made.verdict)


def execute_known(seed: int, combination) -> Executed:
    """The same with a model of the planted terms instead of those of a diagnosis."""
    truth = planted.make(seed, *combination)
    recording = truth.made.recording()
    stages = [geometry(load_robot(robot_keys(recording), "robot"))]
    for row in planted_terms(truth):
        stages.append(Stage(f"{row[1]}.{row[0]}", "planted", (row,), earn=False))
    with tempfile.TemporaryDirectory() as name:
        keys = solution_keys(calibrate(recording, stages))
        (Path(name) / "solution.json").write_text(json.dumps(keys), encoding="utf-8")
        arm = read_solution(Path(name))
    return Executed(seed, *figures_of(truth, arm), _planted(truth), _planted(truth), KNOWN_TERMS)


def planted_terms(truth) -> list[tuple[str, str, dict]]:
    """Rows of a plan (effect, where, options) of the effects that were planted."""
    rows = []
    for effect, where in truth.physics:
        joint, options = int(where.removeprefix("joint-")), {}
        if effect == "transmission-harmonic":
            (wave,) = (one for one in truth.drives["harmonics"] if one.joint == joint)
            options = {"order": int(wave.order)}
        if effect == "zero-shift":
            (slip,) = (one for one in truth.drives["slips"] if one.joint == joint)
            times = truth.made.columns["time_s"]
            options = {"after": float(times[slip.first - 1 : slip.first + 1].mean())}
        rows.append((effect, where, options))
    return rows


def _planted(truth) -> str:
    return "; ".join(f"{effect} at {where}" for effect, where in truth.physics)


def figures_of(truth, arm: CalibratedArm) -> tuple[float, float, float, float, float]:
    """RMS errors before and after, their prediction, the chance of an error above the limit, and the share covered."""
    joints, approach, payload = truth.unseen(TARGETS, seed=2)
    count = float(len(truth.made.columns["sample"]))
    columns = {f"approach{k}": side for k, side in enumerate(approach.T, 1)}
    columns |= {"payload_kg": payload, "time_s": np.full(TARGETS, 10.0 * count)}
    columns |= {"row": np.full(TARGETS, count)}
    found = compensate(arm, np.deg2rad(joints), covariates=columns)
    kept = found.reached
    sides = approach[kept], payload[kept]
    wanted = in_instrument(arm, found.poses[kept])
    after = truth.true_points(np.rad2deg(found.readings[kept]), *sides) - wanted
    before = truth.true_points(joints[kept], *sides) - wanted
    there = {name: values[kept] for name, values in columns.items()}
    covariance = position_covariance(arm, found.readings[kept], there)
    predicted = _rms(found.uncertainty_mm[kept][:, None])
    expanded = found.expanded_uncertainty_mm[kept]
    chance = chance_above(LIMIT * predicted, covariance, 3 * int(count) - len(arm.free))
    covered = float((np.linalg.norm(after, axis=1) <= expanded).mean())
    return _rms(before), _rms(after), predicted, chance, covered


def position_covariance(arm: CalibratedArm, readings: np.ndarray, covariates=None) -> np.ndarray:
    """(3 n, 3 n) mm^2: covariance of the measured point at readings (n, R), x, y and z of each in turn.

    From the covariance of the parameters, whose errors all positions share. covariates: as of `compensate`.
    """
    point, total = _point_and_covariance(arm, readings, covariates)
    alone = total
    for other, chance in considered_arms(arm):
        model = model_at(other, readings, nominal_poses(arm.robot, readings), covariates)
        if is_evaluable(model.effects, model.chain.state):
            moved, covariance = _point_and_covariance(other, readings, covariates)
            total = total + chance * (covariance - alone + np.outer(moved - point, moved - point))
    return total


def _point_and_covariance(arm: CalibratedArm, readings, covariates):
    """(3 n,) mm and (3 n, 3 n) mm^2 of the measured point."""
    model = model_at(arm, readings, nominal_poses(arm.robot, readings), covariates)
    rows, covariance, parameters = position_derivative(model, arm)
    columns = rows.transpose(0, 2, 1).reshape(len(rows), 3 * rows.shape[2])
    return model.residual(parameters)[:3].T.ravel(), columns.T @ covariance @ columns


def chance_above(limit: float, covariance: np.ndarray, degrees: int) -> float:
    """Probability that the RMS 3-D error (mm) of places with a covariance (3 n, 3 n) is above a limit.

    The sum of squares is one of independent chi-squares with the eigenvalues as weights, over the variance factor that
    the covariance was multiplied by: a chi-square of the degrees of freedom of the fit. By 20,000 random draws.
    """
    weights = np.linalg.eigvalsh(covariance)[-_LARGEST:].clip(min=0) / (len(covariance) / 3)
    rng = np.random.default_rng(0)
    squares = rng.chisquare(1, (_DRAWS, len(weights))) @ weights
    factors = rng.chisquare(degrees, _DRAWS) / degrees
    return float((squares / factors > limit**2).mean())


def in_instrument(arm: CalibratedArm, flange: np.ndarray) -> np.ndarray:
    """(n, 3) mm: the calibrated reflector of flange poses (n, 4, 4) in the frame of the instrument."""
    reflector = [arm.values[f"tool.reflector1_{axis}"] for axis in "xyz"]
    base = np.array([arm.values[key] for key in arm.values if key.startswith("base.")][:6])
    in_root = flange[:, :3, :3] @ reflector + flange[:, :3, 3]
    return in_root @ rotation_matrix(base[3:]).T + base[:3]


def _rms(rows: np.ndarray) -> float:
    return float(np.sqrt((rows**2).sum(1).mean()))


def pooled(rows: list[Executed]) -> float:
    """Root mean square of the ratios."""
    return float(np.sqrt(np.mean([row.ratio**2 for row in rows])))


def seeds() -> list[int]:
    """The seeds of all populations, in the order of the table."""
    return [first + number for first in FIRST_SEEDS for number in range(SCENES)]


def scene(seed: int) -> Executed:
    """The scene of a seed of one of the populations."""
    number = seeds().index(seed) % SCENES
    make = execute_known if KNOWN <= seed < KNOWN + SCENES else execute
    return make(seed, COMBINATIONS[number % len(COMBINATIONS)])


def read(table: Path) -> list[Executed]:
    """Scenes of a table; none where there is no file."""
    if not table.is_file():
        return []
    types = {"int": int, "float": float, "str": str}
    kinds = {
        field.name: types[getattr(field.type, "__name__", field.type)] for field in fields(Executed)
    }
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return [Executed(**{key: kinds[key](text) for key, text in row.items()}) for row in rows]


def collect(table: Path = TABLE) -> list[Executed]:
    """All scenes of the populations; those in the table are not computed again."""
    rows = read(table)
    for seed in seeds()[len(rows) :]:
        rows.append(scene(seed))
        with table.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(vars(rows[0])), lineterminator="\n")
            writer.writeheader()
            writer.writerows(vars(row) for row in rows)
        print(f"{rows[-1]} ratio {rows[-1].ratio:.3f}", flush=True)
    return rows


_PAGE = """# Compensation: error of the true arm and predicted uncertainty

This study tests whether the uncertainty that `compensate` predicts agrees with the true error after compensation.

Simulated arms differ from their nominal file in up to two parameters of the geometry and up to three effects
(`datasets/makers/planted.py`, MuJoCo). Each recording has 130 poses and is diagnosed. Then {targets} new targets are
compensated with the result, and MuJoCo moves the true arm to the corrected readings. The ratio is the RMS error of the
measured point over the predicted RMS uncertainty; 1 is expected of a model with the correct terms.
`python tools/study_compensation.py` writes this page; `compensation.csv` has one row per scene. Each population has
{count} scenes. Its seeds were fixed before the first run, and no scene is left out.

![Error of the true arm before and after compensation against the predicted uncertainty](../images/compensation.png)

{figures}

- **Populations 1 to 4** use the models of a diagnosis. They influenced the development: the first led to changes of
  the search, and all four to the present estimate of the error of the model (below). Their predictions were computed
  again from the same models. The model of scene 770104 lacks a term that was found and not retained.
- **Population 5** uses the planted terms, without a diagnosis. It was run once, after the estimate was final.
- **Population 6** uses the models of a diagnosis on unseen scenes. Its seeds were fixed before, and it was run once.

The diagnoses name exactly the planted terms in {exact} of {diagnosed} scenes.

## Contributions to the uncertainty

The predicted uncertainty combines four contributions:

- the covariance of the estimated parameters,
- terms that the diagnosis found and did not retain,
- the extrapolation of error curves and smooth functions beyond the recorded range,
- the error of the model: the part of the held-out error that exceeds the noise and the other contributions.

It does not contain effects that the diagnosis did not find.

## The error of the model

The standard uncertainty of the mean square of a held-out error is 7 % with 130 poses, and the uncertainty of the
parameters adds 8 %. A difference of mean squares, truncated at zero, is therefore determined by chance if the model
has the correct terms. It increased the prediction in 43 of the first 80 scenes (ratios with an RMS of 0.72 to 0.90)
and was zero in the 37 others (RMS 1.07; 9 scenes above {limit}, expected 3.3). The error of the model is instead the
posterior mean of the variance of the discrepancy, with two hypotheses of equal prior probability: no discrepancy, or a
discrepancy with a half-Cauchy distribution in units of the noise (`workbench/fitting/discrepancy.py`). If the held-out
error agrees with noise and parameters, this adds about 8 % to the predicted variance. A significant discrepancy is
added completely.

## Ratios above {limit} for correct models

The prediction is a standard uncertainty (1 sigma). The errors of all targets of a scene depend on the same thirty
parameters approximately, so that they do not average out over the targets. With the eigenvalues w of their covariance,
the sum of squares is the sum of w times independent chi-squares, and the standard deviation of its root is about a
sixth of the prediction. The ratio of a model with the correct terms is therefore above {limit} in up to {worst:.0%} of
the recordings. The expected numbers above follow from the covariance of each scene, and from the {degrees} degrees of
freedom, approximately, that determine the variance factor.

The largest ratio, of seed 64723, is an example. Only two errors of the geometry were planted there, which
the calibration estimates. With 14 other draws of the noise at the same poses, the ratios to the covariance of the
parameters alone are 0.79 to 1.25, RMS 0.99. Those of seed 64738, the second largest of that population, are 0.83 to
1.22, RMS 1.03. Those of seed 2226011, with 12 other draws and the planted terms, are 0.68 to 1.22, RMS 0.97. The noise
causes these ratios, and not a missing term. All scenes above {limit} have the planted terms and no others.

`compensate` also states the expanded uncertainty with the coverage factor {factor} (JCGM 100:2008, 6.2; column
`expanded_uncertainty_mm`). A 3-D error is within it with a probability of 95.4 % if it has one direction, and 99.3 %
if its components are equally distributed. The table at the top states the share of single targets within it, and the
scenes whose RMS error is within it.

## Scenes

| seed | ratio | within the expanded uncertainty | planted effects | terms of the diagnosis | verdict |
|---|---|---|---|---|---|
{rows}
"""


def page(rows: list[Executed]) -> str:
    """The page of these scenes."""
    diagnosed = [row for row in rows if row.verdict != KNOWN_TERMS]
    lines = [
        f"| {row.seed} | {row.ratio:.2f} | {row.covered:.0%} | {row.planted or 'none'} | {row.named or 'none'} "
        f"| {row.verdict} |"
        for row in rows
    ]
    return _PAGE.format(
        count=SCENES,
        targets=TARGETS,
        limit=LIMIT,
        factor=COVERAGE_FACTOR,
        worst=max(row.chance for row in rows),
        degrees=_DEGREES,
        exact=sum(_names(row.planted) == _names(row.named) for row in diagnosed),
        diagnosed=len(diagnosed),
        figures=_figures(rows),
        rows="\n".join(lines),
    )


def _names(text: str) -> set[str]:
    return set(filter(None, text.split("; ")))


def _figures(rows: list[Executed]) -> str:
    """A table of figures, a column a population."""
    populations = [
        [row for row in rows if first <= row.seed < first + SCENES] for first in FIRST_SEEDS
    ]
    remarks = {KNOWN: " (terms known)", UNSEEN: " (unseen)"}
    heads = [
        f"seeds {own[0].seed} to {own[-1].seed}{remarks.get(own[0].seed, '')}"
        for own in populations
    ]
    columns = [_cells(own) for own in populations]
    lines = [f"| | {' | '.join(heads)} |", "|---|" + "---|" * len(heads)]
    for name in columns[0]:
        lines.append(f"| {name} | {' | '.join(column[name] for column in columns)} |")
    return "\n".join(lines)


def _cells(rows: list[Executed]) -> dict[str, str]:
    """Name of a figure -> its text, of one population."""
    ratios = np.array([row.ratio for row in rows])
    count = len(rows)
    return {
        f"scenes with a ratio of at most {LIMIT}": f"{sum(row.is_within for row in rows)} of {count}",
        "the same, expected of models with the right terms": f"{sum(1 - row.chance for row in rows):.1f}",
        f"scenes with a ratio of at most {COVERAGE_FACTOR}": f"{(ratios <= COVERAGE_FACTOR).sum()} of {count}",
        "targets within the expanded uncertainty": f"{np.mean([row.covered for row in rows]):.1%}",
        "the same, scene with the smallest share": f"{min(row.covered for row in rows):.1%}",
        "median ratio": f"{np.median(ratios):.2f}",
        "largest ratio": f"{ratios.max():.2f}",
        "root mean square of the ratios": f"{pooled(rows):.2f}",
        "largest share of the error that remains": f"{max(row.after / row.before for row in rows):.1%}",
    }


if __name__ == "__main__":
    PAGE.write_text(page(collect()), encoding="utf-8")
