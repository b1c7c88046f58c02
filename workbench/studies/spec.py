"""Study files (TOML): simulation or resampling, varied parameters, steps, kept columns; validated key by key."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError, model_validator

from workbench.core.errors import InputError
from workbench.core.robot_files.robot_description import is_robot_file
from workbench.core.text.sections import SceneTable
from workbench.core.text.structured_text import ContentError, read_toml

STUDY_FILES = Path(__file__).parent / "study_files"
METHODS = ("grid", "random", "latin-hypercube", "sobol", "saltelli")
ROOTS = ("scene", "test", "design", "resample")
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_.-]*$", max_length=60)]
Step = Literal["simulate", "calibrate", "diagnose", "compensate"]


class Axis(SceneTable):
    """A varied parameter: `path` (one or several keys with the same value) from `low` to `high` or one of `values`.

    `scale` is linear or logarithmic; a grid has `levels` values. `unit`: of the axis on the pages; where it is
    missing, that at the end of the name or of the path ("sigma_mm").
    """

    name: Name
    path: str | list[str]
    unit: str = ""
    low: float | None = None
    high: float | None = None
    scale: Literal["linear", "log"] = "linear"
    levels: int = Field(5, ge=2, le=10_000)
    values: Annotated[list[int | float | str | list], Field(min_length=1)] | None = None

    @property
    def paths(self) -> list[str]:
        if isinstance(self.path, str):
            return [self.path]
        return self.path

    @model_validator(mode="after")
    def _possible(self):
        if (self.values is None) == (self.low is None or self.high is None):
            raise ValueError("expected either low and high, or values")
        if self.values is None and not self.low < self.high:
            raise ValueError(f"expected low below high, found {self.low:g} and {self.high:g}")
        if self.values is None and self.scale == "log" and not self.low > 0:
            raise ValueError(f"expected low above 0 on a logarithmic scale, found {self.low:g}")
        odd = [
            path for path in self.paths if path.partition(".")[0] not in ROOTS or "." not in path
        ]
        if odd or not self.paths:
            raise ValueError(
                f"expected a path that begins with {', '.join(f'{r}.' for r in ROOTS)}, found {odd}; correct it"
            )
        return self


class Vary(SceneTable):
    """`runs` points by `method` (not for a grid), each repeated `repeats` times with other random numbers."""

    method: Literal[METHODS] = "random"
    runs: int | None = Field(None, ge=1, le=100_000_000)
    repeats: int = Field(1, ge=1, le=1_000_000)
    same_noise: bool = False
    parameter: list[Axis] = []


class Test(SceneTable):
    """Test of a calibrated robot: `samples` further poses of the scene, at each `payload_kg` and `temperature_c`.

    Without these, load and temperature are those of the scene.
    """

    samples: int = Field(200, ge=4, le=1_000_000)
    payload_kg: list[Annotated[float, Field(ge=0)]] = []
    temperature_c: list[float] = []


class Tasks(SceneTable):
    """Task poses: joint readings (deg, mm for a prismatic joint), and the payload."""

    joints_deg: Annotated[list[Annotated[list[float], Field(min_length=1)]], Field(min_length=1)]
    payload_kg: float = Field(0.0, ge=0)
    names: list[str] = []


class Design(SceneTable):
    """Samples of the scene that are measured: `count` of them, selected by `choice`."""

    count: int = Field(30, ge=2)
    choice: Literal["random", "first", "D", "O1", "O2", "O3", "O4", "O5"] = "random"


class Resample(SceneTable):
    """Resampling of a recording: `how` "poses" (poses drawn with replacement) or "noise" (fitted model, new noise).

    `count`: number of poses drawn, default all; `noise`: factor of the fitted sigma.
    """

    how: Literal["poses", "noise"] = "poses"
    count: int | None = Field(None, ge=4)
    noise: float = Field(1.0, ge=0)


class Study(SceneTable):
    """Content of a study file.

    `models`: "geometry", "joint-compliance", "default", or plans by name or file; each calibrates every run.
    `parameters`: keep every calibrated value with its sigma; `keep`: shell patterns of columns; `part`: runs per part
    of the table, which is the unit of work of an executor.
    """

    kind: Literal["compliance", "sensor", "uncertainty", "design"]
    title: str = ""
    seed: int = Field(0, ge=0)
    scene: str | dict | None = None
    recording: str | None = None
    do: list[Step] = ["simulate", "calibrate"]
    models: list[str] = ["geometry"]
    folds: int = Field(5, ge=2, le=100)
    parameters: bool = False
    outcome: str | None = None
    vary: Vary = Vary()
    test: Test = Test()
    tasks: Tasks | None = None
    design: Design | None = None
    resample: Resample = Resample()
    keep: Annotated[list[str], Field(min_length=1)] = ["*"]
    part: int | None = Field(None, ge=1, le=100_000)

    @model_validator(mode="after")
    def _check_complete(self):
        if (self.scene is None) == (self.recording is None):
            raise ValueError("expected either scene or recording")
        if len(set(self.do)) < len(self.do) or not self.do:
            raise ValueError(f"expected each step of do once, found {self.do}")
        if not set(self.do) & {"simulate", "calibrate"} or (
            "compensate" in self.do and "calibrate" not in self.do
        ):
            raise ValueError(
                f"expected do to hold simulate or calibrate, and calibrate before compensate, found "
                f"{self.do}"
            )
        names = [axis.name for axis in self.vary.parameter]
        if len(set(names)) < len(names) or set(names) & {"run", "outcome"}:
            raise ValueError(
                f"expected names of parameters that differ, and neither run nor outcome, found {names}"
            )
        return self


def read_study(path: Path) -> Study:
    """The study of a TOML file, or a bundled study by its name.

    The result is self-contained: it includes the keys of the scene, and paths are absolute. It can be sent to another
    process. Raises InputError with the file, the key and the expected value.
    """
    if str(path) in study_names():
        path = home_of(path) / Path(path).with_suffix(".toml").name
    else:
        path = Path(path)
    study = validated(Study, _toml(path, "study"), f"study {path}")
    if isinstance(study.scene, str):
        file = path.parent / study.scene
        return study.model_copy(
            update={"scene": _with_absolute_robot(_toml(file, "scene"), file.parent)}
        )
    if study.scene is not None:
        return study.model_copy(update={"scene": _with_absolute_robot(study.scene, path.parent)})
    return study.model_copy(update={"recording": _recording(study.recording, path.parent)})


def home_of(path: Path) -> Path:
    """The folder that paths in a study file are relative to."""
    if str(path) in study_names():
        return STUDY_FILES
    return Path(path).parent


def study_names() -> list[str]:
    """Names of the bundled studies."""
    return sorted(
        path.stem
        for path in STUDY_FILES.glob("*.toml")
        if not path.stem.startswith(("scene-", "plan-"))
    )


def _toml(path: Path, kind: str) -> dict:
    try:
        return read_toml(path)
    except FileNotFoundError:
        known = f", or one of {', '.join(study_names())}" if kind == "study" else ""
        raise InputError(
            f"{path}: expected a {kind} (TOML){known}, found no such file; correct its name"
        ) from None
    except (OSError, ContentError) as problem:
        raise InputError(
            f"{path}: expected a {kind} (TOML), found an unreadable file ({problem}); correct it"
        ) from None


def _with_absolute_robot(scene: dict, folder: Path) -> dict:
    """The scene with an absolute path of its robot file, if it names one."""
    robot = scene.get("robot")
    if isinstance(robot, str) and is_robot_file(robot):
        return scene | {"robot": str((folder / robot).resolve())}
    return scene


def _recording(name: str, folder: Path) -> str:
    """Absolute path of a recording folder relative to the study; other names are returned unchanged."""
    if (folder / name).is_dir():
        return str((folder / name).resolve())
    return name


def validated(kind, keys: dict, called: str):
    """A pydantic table of `keys`; InputError with one sentence that names `called` and the key."""
    try:
        return kind(**keys)
    except ValidationError as problem:
        raise InputError(_sentence(problem.errors()[0], called)) from None
    except TypeError:
        raise InputError(
            f"{called}: expected keys and values, found {keys!r:.60}; correct it"
        ) from None


def _sentence(first: dict, called: str) -> str:
    key = ".".join(str(part + 1 if isinstance(part, int) else part) for part in first["loc"])
    message = first["msg"].removeprefix("Value error, ")
    message = message[0].lower() + message[1:]
    found = "" if first["type"] == "value_error" else f", found {first['input']!r:.80}"
    if first["type"] == "extra_forbidden":
        message, found = "this key is not known", ""
    return f"{called}{f', key {key}' if key else ''}: {message}{found}; correct or remove it"
