"""Load an arm: by its builtin name, from robot.toml or from a URDF file."""

from collections.abc import Mapping
from importlib import resources
from os import PathLike
from pathlib import Path

from robot_model.files.robot_file import read_robot_keys, robot_from_keys
from robot_model.files.urdf import robot_from_urdf
from robot_model.robot import Robot, wrong
from workbench.core.robot_files.builtin_names import check_builtin_name
from workbench.core.robot_files.robot_description import description_keys, is_description


def builtin_robots() -> list[str]:
    """Names that `load_robot` knows without a file."""
    folder = resources.files("robot_model").joinpath("robots")
    return sorted(
        f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml")
    )


def load_robot(spec: Mapping | str | PathLike, where: str = "robot") -> Robot:
    """The arm that `spec` names.

    spec: the keys of robot.toml; {"builtin": name}, also with `payload`; {"urdf": path, "joints": [...], "tip": link}
    (see `urdf.robot_from_urdf`); a path to a .toml, .urdf or MJCF (.xml, .mjcf) file, the latter two also
    as FILE#LINK, the link being the flange; or a builtin name.
    where: what to call a mapping in an error sentence, usually the file that it came from.
    Raises InputError where the arm is not known or its numbers cannot be right.
    """
    if not isinstance(spec, Mapping):
        return _load_named(Path(spec), where)
    if "urdf" in spec:
        return robot_from_urdf(spec, where)
    if "builtin" in spec:
        return _load_builtin(spec, where)
    return robot_from_keys(spec, where)


def _load_named(path: Path, where: str) -> Robot:
    if is_description(path):
        return load_robot(description_keys(path), str(path))
    if path.suffix.lower() == ".toml":
        keys = read_robot_keys(path)
        if isinstance(keys.get("urdf"), str):
            keys["urdf"] = str(path.parent / keys["urdf"])
        return load_robot(keys, str(path))
    check_builtin_name(str(path), where, builtin_robots())
    return load_robot({"builtin": str(path)})


def whole_keys(spec: Mapping) -> dict:
    """Keys of robot.toml of an arm, those of a built-in one in place of its name, so that others can be added."""
    if "builtin" not in spec:
        return dict(spec)
    return _builtin_keys(spec)


def _builtin_file(name: str):
    return resources.files("robot_model").joinpath("robots", f"{name}.toml")


def _load_builtin(spec: Mapping, where: str) -> Robot:
    name = spec["builtin"]
    if spec.keys() - {"builtin", "payload"}:
        raise wrong(
            f"{where}: key builtin",
            "no other key than payload next to it",
            ", ".join(map(str, spec)),
            "remove the others",
        )
    check_builtin_name(name, f"{where}: key builtin", builtin_robots())
    return robot_from_keys(_builtin_keys(spec), f"{name}.toml")


def _builtin_keys(spec: Mapping) -> dict:
    """Keys of the file of a built-in arm, with the `payload` that stands next to its name."""
    payload = {key: spec[key] for key in ("payload",) if key in spec}
    return {**read_robot_keys(_builtin_file(spec["builtin"])), **payload}
