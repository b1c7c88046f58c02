"""The derivative of the arm's end by all numbers of its geometry, as an expert writes it in jax: forward mode,
vectorised over poses, compiled, in double precision, on one thread."""

import os

os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
)

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from benchmarks.problem import Problem, last_twist, modified_rows  # noqa: E402

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_platforms", "cpu")


def jacobian(problem: Problem, point: np.ndarray):
    """A function without arguments that gives (3, n, 30): base x, y, z, rx, ry, rz, then theta, d, a, alpha by joint.

    At a base of zero; mm and rad. It is compiled before it is returned.
    """
    rows = modified_rows(problem.robot)[:, [2, 3, 1, 0]]
    after = last_twist(problem.robot) @ np.append(point, 1.0)
    start = jnp.asarray(np.concatenate([np.zeros(6), rows.ravel()]))
    q = jnp.asarray(problem.variables)

    def end(numbers):
        reached = tuple(jnp.full(q.shape[1], length) for length in after[:3])
        for joint in reversed(range(6)):
            theta, d, a, alpha = numbers[6 + 4 * joint : 10 + 4 * joint]
            reached = _link((theta + q[joint], d, a, alpha), reached)
        reached = jnp.stack(reached)
        return reached + jnp.cross(numbers[3:6], reached, axisb=0).T + numbers[:3, None]

    compiled = jax.jit(jax.jacfwd(end))

    def made():
        return np.asarray(compiled(start).block_until_ready())

    made()
    return made


def _link(numbers, reached):
    """Points (n,) x, y, z before a joint: its rotation and offset, then its length and twist in Craig's order."""
    (theta, d, a, alpha), (x, y, z) = numbers, reached
    turned, along = jnp.sin(theta) * x + jnp.cos(theta) * y, z + d
    first = jnp.cos(theta) * x - jnp.sin(theta) * y + a
    cosine, sine = jnp.cos(alpha), jnp.sin(alpha)
    return first, cosine * turned - sine * along, sine * turned + cosine * along
