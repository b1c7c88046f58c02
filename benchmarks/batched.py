"""`python -m benchmarks.batched [SAMPLES]`: normal equations of an arm by numpy and by torch, here and on a graphics
card.

Prints seconds, the ratio to numpy, and by how much the normal matrices differ, in both precisions.
"""

import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.large import SCENE
from robot_model.system import geometry_free
from workbench.core.least_squares import batched
from workbench.jobs.robot.simulate import truth_from

CHUNK = 8192


def main(words: list[str]) -> int:
    """The table; 1 where results differ by more than they may."""
    samples = int(words[0]) if words else 1_000_000
    model, parameters, columns = _problem(samples)
    start = time.perf_counter()
    reference = _numpy(model, parameters)
    usual = time.perf_counter() - start
    print(f"{samples:,} samples, {len(reference)} columns: numpy {usual:.2f} s")
    return max(
        [
            _row(model, parameters, reference, columns, usual, where, single)
            for where in _places()
            for single in (False, True)
        ]
    )


def _problem(samples):
    truth = truth_from(
        SCENE.model_copy(update={"samples": samples, "effect": []}), Path("benchmark")
    )
    robot = truth.model.chain.robot
    free = truth.parameters.free("tool.*", *geometry_free(robot))
    places = np.flatnonzero(free.mask)
    return truth.model, free, places


def _numpy(model, parameters):
    """(F, F), chunk by chunk, which is quicker than all at once."""
    size = int(parameters.mask.sum())
    normal = np.zeros((size, size))
    for first in range(0, model.chain.n, CHUNK):
        _, rows = model.at(slice(first, first + CHUNK)).linearise(parameters)
        flat = rows.reshape(size, -1)
        normal += flat @ flat.T
    return normal / SCENE.sigma_mm**2


def _places():
    return dict.fromkeys(("cpu", batched.device()))


def _row(model, parameters, reference, columns, usual, where, single) -> int:
    chain = model.chain
    robot, pose = chain.robot, chain.split(parameters.values)
    from workbench.core.rigid import rotation_matrix, transform

    arm = batched.Arm(pose[1], robot.prismatic, robot.convention, robot.base, robot.flange)
    base = transform(rotation_matrix(pose[0][3:]), pose[0][:3])
    words = (
        arm,
        chain.variables,
        base,
        pose[2].reshape(-1, 3),
        chain.measurement.index,
        chain.measurement.measured,
        SCENE.sigma_mm,
    )
    batched.normal_equations(
        *(w[:, :100] if np.ndim(w) == 2 and w.shape[1] == chain.n else w for w in words[:4]),
        words[4][:100],
        words[5][:, :100],
        words[6],
        where=where,
        single=single,
    )
    start = time.perf_counter()
    normal = batched.normal_equations(*words, where=where, single=single)[0]
    seconds = time.perf_counter() - start
    scale = np.sqrt(np.diag(reference))
    off = np.abs((normal[np.ix_(columns, columns)] - reference) / np.outer(scale, scale)).max()
    bound = 1e-4 if single else 1e-9
    print(
        f"torch, {where}, {'single' if single else 'double'}: {seconds:.2f} s, {usual / seconds:.1f} times as "
        f"fast; differs by {off:.1e} (at most {bound:g})"
    )
    return int(off > bound)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
