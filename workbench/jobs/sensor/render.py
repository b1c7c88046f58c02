"""From a scene to a recording of rendered images; where an arm holds the scanner, it is the true arm that does."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from robot_model.poses import pose_values
from sensors.rendering.recording import Stations, make_recording
from sensors.rendering.scene import Scene, read_scene
from workbench.core.errors import InputError
from workbench.core.rigid import rotation_matrix, transform
from workbench.jobs.robot.simulate import Truth, truth_of
from workbench.machine.progress import paced

_NOT_THE_ARMS = ("sensor", "target", "noise")
_MEASURED = ("x_mm", "y_mm", "z_mm", "range_mm")


def render(path: Path, folder: Path, progress: Callable[[str], None]) -> dict:
    """Render the scene file `path` into an empty folder, which then is a recording.

    progress: called with one line a image. Returns `images`, `samples`, `measures` and `truth`,
    what the images were made from. Raises InputError for a scene that cannot be.
    """
    scene = read_scene(path)
    arm = truth_of(Path(scene.arm)) if scene.arm else None
    stations = None if arm is None else stations_of(arm, scene, path)
    recording = make_recording(scene, folder, paced(progress, "image"), stations)
    truth = {**recording.truth, **({} if arm is None else {"arm": arm_truth(arm)})}
    kinds = {row["role"] for row in recording.images}
    return {
        "measures": "board-images" if kinds == {"board"} else "scan-images",
        "images": len(recording.images),
        "samples": 0 if stations is None else len(stations.poses),
        "truth": truth,
    }


def stations_of(arm: Truth, scene: Scene, path: Path) -> Stations:
    """True sensor poses at the recorded joint readings, one station for each scan."""
    shown = arm.shown
    if shown.measures != "ball-centre":
        raise InputError(
            f"scene {path}, key arm: expected a ball-centre scene, found {shown.measures}; correct measures "
            f"in {Path(scene.arm).name}"
        )
    if list(map(tuple, scene.balls)) != [tuple(ball) for ball in shown.balls.values()]:
        raise InputError(
            f"scene {path}, key balls: expected the balls of {Path(scene.arm).name}, found others; copy them"
        )
    odd = next((effect for effect in arm.model.effects if effect.port in _NOT_THE_ARMS), None)
    if odd is not None:
        raise InputError(
            f"scene {path}, key arm: expected effects of the arm in {Path(scene.arm).name}, found "
            f"{odd.effect} of the {odd.where}; write it in {Path(path).name}"
        )
    columns = {name: values for name, values in shown.columns.items() if name not in _MEASURED}
    section = shown.robot if "builtin" in shown.robot else {}
    return Stations(sensor_poses(arm), columns, {} if section else shown.robot, section)


def sensor_poses(arm: Truth) -> np.ndarray:
    """(n, 4, 4) T_artefact_sensor, mm: the true arm with all its effects, and its hand-eye."""
    model, values = arm.model, arm.parameters.values
    frames = model.evaluate(arm.parameters).frames
    rotation = np.stack(frames.end, -1).transpose(1, 0, 2)
    flange = transform(rotation, frames.end_origin.T)
    _, _, tool = model.chain.split(values[: len(model.chain.parameters)])
    return flange @ transform(rotation_matrix(tool[3:6]), tool[:3])


def arm_truth(arm: Truth) -> dict:
    """Parameters that are not at their nominal value, and T_artefact_sensor of each sample as six numbers."""
    values = zip(arm.parameters.table, arm.parameters.values.tolist())
    poses = sensor_poses(arm)
    return {
        "parameters": [
            {"key": p.key, "value": value, "unit": p.unit, "nominal": p.null}
            for p, value in values
            if value != p.null
        ],
        "T_artefact_sensor": [
            {"sample": int(sample), "pose": pose_values(pose[:3, :3], pose[:3, 3]).tolist()}
            for sample, pose in zip(arm.shown.sample_ids, poses)
        ],
    }
