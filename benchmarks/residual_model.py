"""`python -m benchmarks.residual_model`: held-out errors of the physics and of a Gaussian process, on the same folds.

Both see the same samples of each recording and predict the same blocks of consecutive poses. Recordings that other
people made are looked for as in the rest of the project; one that is not there is left out of the table.
"""

import argparse
import sys
from dataclasses import dataclass

import numpy as np

import datasets
from benchmarks.gaussian_process import learn, predict
from robot_model.system import bind
from workbench.core.errors import InputError
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.fitting.calibration_plans.plans import geometry, stage_mask
from workbench.jobs.robot.calibrate import calibrate

# name, and which of its poses are taken: every first, third ... as a search of hours proves nothing more
RECORDINGS = (
    ("irb120_wu_arm", 1),
    ("fanuc165f_innopolis", 1),
    ("motoman_leica_ctu:right", 1),
    ("motoman_leica_ctu:left", 1),
    ("irb120_faro", 3),
    ("ur10_ipa_tmac_A", 4),
)
_REFLECTOR_MM = (
    100.0  # by which the place of a reflector on the tool differs as much as an angle by a radian
)


@dataclass(frozen=True)
class Compared:
    """Held-out RMS 3-D position errors, mm, of one recording with `poses` poses."""

    name: str
    poses: int
    geometry: float
    process: float
    physics: float


def compare(name: str, step: int) -> Compared:
    """Physics by the default plan of `calibrate`, and geometry with a Gaussian process, on the folds of the former."""
    recording = datasets.read(name)
    _, pose = np.unique(recording.poses, return_inverse=True)
    if step > 1:
        recording = recording.select(pose % step == 0)
    made = calibrate(recording)
    fold, used = made.fold, made.fold >= 0
    chain = bind(made.robot, made.recording)
    inputs = _inputs(chain)
    plain = np.full((3, made.recording.n), np.nan)
    corrected = plain.copy()
    for k in np.unique(fold[used]):
        test, fit_on = fold == k, used & (fold != k)
        seen, left = _geometry_residuals(chain, fit_on, test)
        kernel = learn(inputs[fit_on], seen.T)
        plain[:, test] = left
        corrected[:, test] = left - predict(kernel, inputs[fit_on], seen.T, inputs[test]).T
    poses = len(np.unique(made.recording.poses))
    return Compared(name, poses, _rms(plain), _rms(corrected), made.held_out["rms_mm"])


def _inputs(chain) -> np.ndarray:
    """(n, D) joint variables that move, and the place of the reflector where there are several."""
    columns = [q for q in chain.variables if np.ptp(q) > 1e-6]
    if len(np.unique(chain.state.index)) > 1:
        columns += [x for x in chain.state.target / _REFLECTOR_MM if np.ptp(x) > 1e-6]
        if len(columns) == len(chain.variables):
            columns.append(chain.state.index.astype(float))
    return np.stack(columns, 1)


def _geometry_residuals(chain, fit_on, test) -> tuple[np.ndarray, np.ndarray]:
    """(3, fitted) and (3, tested) position residual, mm, of base, link geometry and tool fitted on `fit_on`."""
    model = Model(chain.at(fit_on))
    mask = stage_mask(model.parameters, geometry(chain.robot), (), chain)
    fit = solve(model, model.parameters.only(mask), "huber")
    return fit.residual[:3], Model(chain.at(test)).residual(fit.parameters)[:3]


def _rms(residual: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean((residual**2).sum(0))))


def main(arguments=None) -> int:
    """Print the table; exit status 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="rows whose name contains this word")
    only = parser.parse_args(arguments).only
    print("| recording | poses | geometry | geometry and Gaussian process | physics |")
    print("|---|---|---|---|---|", flush=True)
    for name, step in RECORDINGS:
        if only not in name:
            continue
        try:
            row = compare(name, step)
        except InputError as error:
            print(f"{name}: {error}", file=sys.stderr)
            continue
        figures = " | ".join(f"{x:.3f}" for x in (row.geometry, row.process, row.physics))
        print(f"| `{row.name}` | {row.poses} | {figures} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
