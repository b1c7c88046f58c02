"""Whether a plan can model an error of the parallelism of two axes that are nominally parallel."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from robot_model.robot import Robot
from workbench.core.solution import Stage

_WARNING = (
    "Axes {first} and {second} are nominally parallel, and the plan does not estimate {key}: an error of their "
    "parallelism stays in the residual and biases other parameters. Add {key} to the key free of its first stage; "
    "the plan ye-2024-hayati shows how."
)


def parallelism_warnings(stages: Sequence[Stage], robot: Robot) -> tuple[str, ...]:
    """A sentence for every pair of nominally parallel axes whose beta no stage of the plan frees.

    Four Denavit-Hartenberg numbers cannot turn an axis against a parallel one about their common normal's plane:
    Hayati & Mirmirani 1985. A plan that frees none of the geometry is meant so and gets no warning.
    """
    patterns = [pattern for stage in stages for pattern in stage.free]
    held_patterns = [pattern for stage in stages for pattern, _ in stage.hold]
    geometry = [
        f"joint-{k + 1}.{n}{k + 1}" for k in range(robot.joints) for n in ("theta", "alpha")
    ]
    if not any(_matches(key, patterns) for key in geometry):
        return ()
    parallel = [k + 1 for k in range(robot.joints) if robot.hayati[k]]
    keys = {k: f"joint-{k}.beta{k}" for k in parallel}
    return tuple(
        _WARNING.format(first=k, second=k + 1, key=key)
        for k, key in keys.items()
        if not _matches(key, [*patterns, *held_patterns])
    )


def _matches(key: str, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(key, pattern) for pattern in patterns if pattern != "*")
