"""Run folders that hold a corrected model: plan.toml, solution.json and scene.toml of `workbench diagnose`."""

from pathlib import Path

from workbench.core.errors import InputError

PLAN, SCENE = "plan.toml", "scene.toml"


def is_model_run(path: Path) -> bool:
    """Whether a folder holds a corrected model, and is not itself a recording."""
    return (path / PLAN).is_file() and not (path / "recording.toml").is_file()


def scene_of(path: Path) -> Path:
    """The scene file that a path names: itself, or that of a run folder. Raises InputError where a folder has none."""
    if not path.is_dir():
        return path
    if not (path / SCENE).is_file():
        raise InputError(
            f"{path}: expected a scene (TOML) or the run folder of `workbench diagnose` with a {SCENE}, found a folder "
            "without one; the answer.json of the run says in model.left_out why there is none."
        )
    return path / SCENE
