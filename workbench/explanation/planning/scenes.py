"""A planned recording as a scene that `workbench simulate` runs: the fitted arm with what was found in it."""

import numpy as np

from robot_model.effects import CATALOGUE
from workbench.files.solution_file import robot_keys
from workbench.jobs.robot.corrected_scene import (
    KINDS,
    covariate_keys,
    effect_keys,
    pose_keys,
    share_of_limits,
    target_keys,
)

SCENE = "next-experiment.toml"
ROBOT = "next-experiment.robot.toml"


def scene_of(bench, others, doubtful, plan, poses: int) -> tuple[dict | None, dict | None]:
    """Keys of a scene, and of the robot's file that it names; None where a scene cannot hold this recording.

    The whole recording as it would be with the further poses: the fitted base and tool, the findings with a name and
    their values, and the changed covariate at random over its range.
    """
    recording = bench.recording
    if recording.measures not in KINDS:
        return None, None
    model, fit, _ = bench.solve(doubtful.model_effects(others))
    values = fit.parameters
    robot = robot_keys(recording)
    keys = {
        "robot": robot["builtin"] if "builtin" in robot else ROBOT,
        "measures": recording.measures,
        "title": f"{recording.title or recording.name}: {plan.name}",
        "samples": int(recording.n + poses * max(1, round(len(plan.pose) / (plan.pose.max() + 1)))),
        "seed": 0,
        "sigma_mm": float(np.median(model.sigma(values)[:3])),
        "share_of_limits": share_of_limits(model.chain),
        "base": pose_keys(values, "base"),
        **target_keys(recording, values, model.chain),
        **covariate_keys(recording),
        **plan.scene,
        "effect": [
            effect_keys(e, values, model.chain)
            for e in (*bench.baseline, *others, *doubtful.own)
            if _named(e)
        ],
    }
    return keys, None if "builtin" in robot else robot


def _named(effect) -> bool:
    return type(effect) in CATALOGUE.values()
