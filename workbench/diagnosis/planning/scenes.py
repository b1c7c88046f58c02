"""A planned recording as a scene that `workbench simulate` runs: the fitted arm with what was found in it."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from robot_model.effects import CATALOGUE
from workbench.core.least_squares.linear_algebra import least_squares
from workbench.core.vocabulary import Covariate

_KINDS = ("external-point", "external-pose", "ball-centre")
SCENE, ROBOT = "next-experiment.toml", "next-experiment.robot.toml"


def scene_of(bench, others, doubt, plan, poses: int) -> tuple[dict | None, dict | None]:
    """Keys of a scene, and of the robot's file that it names; None where a scene cannot hold this recording.

    The whole recording as it would be with the further poses: the fitted base and tool, the findings with a name and
    their values, and the changed covariate at random over its range.
    """
    recording = bench.recording
    if recording.measures not in _KINDS:
        return None, None
    model, fit, _ = bench.solve((*others, *doubt.own))
    values = fit.parameters
    robot = _robot(recording)
    keys = {
        "robot": robot["builtin"] if "builtin" in robot else ROBOT,
        "measures": recording.measures,
        "title": f"{recording.title or recording.name}: {plan.name}",
        "samples": int(recording.n + poses * max(1, round(len(plan.pose) / (plan.pose.max() + 1)))),
        "seed": 0,
        "sigma_mm": float(np.median(model.sigma(values)[:3])),
        "share_of_limits": _share(model.chain),
        "base": _pose(values, "base"),
        **_targets(recording, values, model.chain),
        **_held(recording),
        **plan.scene,
        "effect": [
            _cause(e, values, model.chain)
            for e in (*bench.baseline, *others, *doubt.own)
            if _named(e)
        ],
    }
    return keys, None if "builtin" in robot else robot


def _robot(recording) -> dict:
    keys = dict(recording.robot)
    if "urdf" in keys:
        keys["urdf"] = str(Path(recording.folder or ".", keys["urdf"]).resolve())
    return keys


def _named(effect) -> bool:
    return type(effect) in CATALOGUE.values()


def _cause(effect, values, chain) -> dict:
    name = next(key for key, kind in CATALOGUE.items() if kind is type(effect))
    own = [p.key for p in effect.parameters(chain)]
    ends = [key.rpartition(".")[2] for key in own]
    told = {end if ends.count(end) == 1 else key: values[key] for end, key in zip(ends, own)}
    return {"effect": name, "where": effect.where, **effect.options, "values": told}


def _pose(values, where) -> dict:
    if f"{where}.x" not in values.index:
        return {}
    shift, turn = (
        [values[f"{where}.{name}"] for name in names] for names in ("xyz", ("rx", "ry", "rz"))
    )
    rpy = Rotation.from_rotvec(turn).as_euler("xyz", degrees=True)
    return {"xyz_mm": [float(x) for x in shift], "rpy_deg": rpy.tolist()}


def _targets(recording, values, chain) -> dict:
    """Reflectors on the flange, or tool and balls."""
    if recording.measures == "external-point":
        return {
            "reflectors": [
                [values[f"tool.reflector{r}_{a}"] for a in "xyz"] for r in chain.measurement.ids
            ]
        }
    if recording.measures == "external-pose":
        return {"tool": _pose(values, "tool")}
    return {
        "tool": _pose(values, "sensor"),
        "balls": [list(map(float, recording.balls[k])) for k in recording.balls],
    }


def _share(chain) -> float:
    """How much of the joints' limits the recording uses: its largest share, within what a scene takes."""
    limits = chain.robot.limits
    span = np.ptp(limits, axis=1)
    readings = least_squares(chain.robot.mixing, chain.variables)
    used = np.ptp(readings, axis=1) / np.where(np.isfinite(span) & (span > 0), span, 2 * np.pi)
    return float(np.clip(np.median(used), 0.05, 1.0))


def _held(recording) -> dict:
    """The covariates that a scene can hold, over the ranges in which they were recorded."""
    columns, held = recording.columns, {}
    if "payload_kg" in columns:
        held["payload_kg"] = [
            float(columns["payload_kg"].min()),
            float(columns["payload_kg"].max()),
        ]
    if "temperature_c" in columns:
        held["temperature_c"] = [
            float(columns["temperature_c"].min()),
            float(columns["temperature_c"].max()),
        ]
    if any(Covariate.of(name).is_signed for name in columns):
        held["approach"] = True
    speeds = [np.abs(columns[c]).max() for c in columns if Covariate.of(c).kind == "qdot"]
    return held | ({"speeds_deg_s": float(max(speeds))} if speeds else {})
