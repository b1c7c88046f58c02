"""Scene files of `workbench render`: the instrument, what stands before it and what is wrong with it, checked."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from sensors.boards.board import Board
from sensors.camera.model import Camera
from sensors.rendering.instrument import Chip, Instrument, Lamp, Laser, Optics, sweeping_mirror
from sensors.rendering.patterns import Pattern
from sensors.rendering.ports import Causes, make_causes
from workbench.core.errors import InputError
from workbench.core.text.sections import Ball, SceneTable, rising
from workbench.core.text.structured_text import ContentError, read_toml

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Span = Annotated[tuple[Positive, Positive], AfterValidator(rising)]


class CameraKeys(SceneTable):
    """As in scanner.toml: px, OpenCV's order of k1 k2 p1 p2 k3 (k4 k5 k6)."""

    width_px: int = Field(ge=16, le=20_000)
    height_px: int = Field(ge=16, le=20_000)
    fx_px: Positive
    fy_px: Positive
    cx_px: float
    cy_px: float
    distortion: Annotated[list[float], Field(min_length=5, max_length=8)] = [0.0] * 5


class LensKeys(SceneTable):
    """Blur, 1 sigma: `Optics`."""

    blur_px: float = Field(0.6, gt=0)
    focus_mm: Positive = 125.0
    defocus_px: float = Field(8.0, ge=0)
    vignetting: float = Field(0.0, ge=0, le=20)


class ChipKeys(SceneTable):
    """From electrons to numbers: `Chip`."""

    full_well_e: Positive = 10_000.0
    read_noise_e: float = Field(12.0, ge=0)
    black: float = Field(0.01, ge=0, lt=1)
    bits: Literal[8, 10, 12, 16] = 8
    blooming: Share = 0.0
    spill_px: Positive = 3.0


class LampKeys(SceneTable):
    """Shares of the full well from a white surface: `Lamp`."""

    board: float = Field(0.7, ge=0)
    laser: float = Field(0.01, ge=0)
    background: Share = 0.05
    towards: tuple[float, float, float] | None = None


class LaserKeys(SceneTable):
    """`source_mm` where the light of a fixed light plane comes from, camera frame; a mirror has its own."""

    width_mm: Positive = 0.06
    peak: Positive = 0.7
    speckle_contrast: float = Field(0.1, ge=0, le=1)
    speckle_grain_px: float = Field(0.8, ge=0)
    rayleigh_mm: float = Field(float("inf"), gt=0, allow_inf_nan=True)
    uneven: Share = 0.0
    uneven_deg: Positive = 5.0
    indirect: Share = 0.0
    source_mm: Vector | None = None


class MirrorKeys(SceneTable):
    """A mirror `baseline_mm` from the camera that throws the light plane to z = `aim_mm` on the optical axis.

    Its face stands `offset_mm` from its axis, which leans by `tilt_deg` about x and z; the laser is
    `laser_mm` away. `steps` images from `first_deg` to `last_deg`, mirror angles: light turns twice as far.
    Scans go both ways in turn where `both_ways`, at a speed at random within `speed_deg_s`.
    """

    baseline_mm: Positive = 69.0
    aim_mm: Positive = 125.0
    offset_mm: float = 2.0
    laser_mm: Positive = 60.0
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    steps: int = Field(120, ge=1, le=10_000)
    first_deg: float = -5.0
    last_deg: float = 5.0
    both_ways: bool = False
    speed_deg_s: Span = (2.0, 2.0)


class PlaneKeys(SceneTable):
    """A fixed light plane n.X + b = 0, camera frame."""

    normal: Vector
    offset_mm: float


class BoardKeys(SceneTable):
    """[board] as recording.toml has it, and how it is printed; `margin` and `radius` in steps of the grid."""

    kind: Literal["chessboard", "charuco", "circles"] = "chessboard"
    columns: int = Field(11, ge=2)
    rows: int = Field(8, ge=2)
    square_mm: Positive = 3.0
    asymmetric: bool = False
    marker_mm: float | None = Field(None, gt=0)
    dictionary: str | None = None
    legacy: bool = False
    white: Share = 0.85
    dark: Share = 0.12
    margin: float = Field(1.0, ge=0)
    negative: bool = False
    radius: float = Field(0.3, gt=0, lt=0.5)

    @property
    def recorded(self) -> dict:
        """The keys of recording.toml."""
        keys = {
            "kind": self.kind,
            "columns": self.columns,
            "rows": self.rows,
            "square_mm": self.square_mm,
        }
        optional = {
            name: getattr(self, name)
            for name in ("asymmetric", "marker_mm", "dictionary", "legacy")
        }
        return keys | {name: value for name, value in optional.items() if value}

    @property
    def pattern(self) -> Pattern:
        """The printed pattern."""
        return Pattern(
            Board.of(self.recorded), self.white, self.dark, self.margin, self.negative, self.radius
        )


class Place(SceneTable):
    """Board or artefact in the camera frame: mm, then roll, pitch, yaw about fixed x, y, z in degrees."""

    xyz_mm: Vector
    rpy_deg: Vector = [0.0, 0.0, 0.0]


class Views(SceneTable):
    """`count` places at random: the middle at `range_mm`, up to `aside` of the field off its middle, turned
    by up to `roll_deg` in the image and tilted by up to `tilt_deg`; or the `places` themselves. Of a board: at
    the first `laser` of them (all where not given) the stripe is taken too, at every step."""

    count: int = Field(0, ge=0, le=100_000)
    range_mm: Span = (115.0, 135.0)
    aside: Share = 0.5
    tilt_deg: float = Field(30.0, ge=0, lt=85)
    roll_deg: float = Field(15.0, ge=0, le=180)
    places: list[Place] = []
    laser: int | None = Field(None, ge=0)


class MeshKeys(SceneTable):
    """A file that Open3D reads, mm, in the artefact's frame."""

    file: str
    white: Share = 0.7


class Cause(BaseModel):
    """An effect, its place, its options (any further key) and its parameters, by the last part of their key."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)
    effect: str
    where: str
    values: dict[str, float]


class Scene(SceneTable):
    """One file. `parts`: samples a pixel's side of board and stripe images.

    `balls`: [x, y, z, radius] of the certificate, artefact frame, mm. `temperature_c` [first, last]: a ramp over
    the recording, constant while the mirror sweeps. `arm`: a scene of `workbench simulate`, a file in the same folder,
    that says where the sensor stands in each scan and gives the readings; then `scans` is left out.
    """

    title: str = "rendered"
    seed: int = Field(0, ge=0)
    camera: CameraKeys
    lens: LensKeys = LensKeys()
    chip: ChipKeys = ChipKeys()
    lamp: LampKeys = LampKeys()
    laser: LaserKeys = LaserKeys()
    mirror: MirrorKeys | None = None
    plane: list[PlaneKeys] = []
    board: BoardKeys = BoardKeys()
    placements: Views = Views(count=20, laser=10)
    balls: list[Ball] = []
    ball_white: Share = 0.8
    ball_gloss: float = Field(0.0, ge=0, le=100)
    ball_gloss_exponent: float = Field(50.0, ge=1)
    mesh: MeshKeys | None = None
    scans: Views = Views()
    arm: str | None = None
    temperature_c: tuple[float, float] | None = None
    parts: tuple[Annotated[int, Field(ge=1, le=16)], Annotated[int, Field(ge=1, le=16)]] = (4, 2)
    effect: list[Cause] = []

    @model_validator(mode="after")
    def _check_contents(self):
        if self.mirror is not None and self.plane:
            raise ValueError("expected either [mirror] or [[plane]], found both")
        if self.scans.count + len(self.scans.places) and not (self.balls or self.mesh):
            raise ValueError("scans need balls or a mesh, found none")
        return self

    @property
    def sees(self) -> Camera:
        """The true camera."""
        keys = self.camera
        values = [keys.fx_px, keys.fy_px, keys.cx_px, keys.cy_px, *keys.distortion]
        return Camera.of(values, (keys.width_px, keys.height_px))

    @property
    def instrument(self) -> Instrument:
        """The true instrument."""
        mirror = angles = planes = None
        laser = self.laser.model_dump(exclude={"source_mm", "speckle_contrast", "speckle_grain_px"})
        laser |= {"contrast": self.laser.speckle_contrast, "grain_px": self.laser.speckle_grain_px}
        source = None if self.laser.source_mm is None else np.array(self.laser.source_mm)
        steps = np.arange(len(self.plane))
        if self.mirror is not None:
            keys = self.mirror
            mirror, source = sweeping_mirror(
                keys.baseline_mm, keys.aim_mm, keys.offset_mm, keys.laser_mm, keys.tilt_deg
            )
            steps = np.arange(keys.steps)
            angles = np.deg2rad(np.linspace(keys.first_deg, keys.last_deg, keys.steps))
            laser["reach_mm"] = keys.laser_mm + float(np.hypot(keys.baseline_mm, keys.aim_mm))
        elif self.plane:
            planes = np.array([[*plane.normal, plane.offset_mm] for plane in self.plane]).T
            planes = planes / np.linalg.norm(planes[:3], axis=0)
            if source is not None:
                laser["reach_mm"] = float(np.linalg.norm(source - [0, 0, self.lens.focus_mm]))
        return Instrument(
            self.sees,
            steps,
            angles,
            mirror,
            planes,
            Optics(**self.lens.model_dump()),
            Chip(**self.chip.model_dump()),
            Laser(**laser, source=source),
            Lamp(**self.lamp.model_dump()),
        )

    @property
    def columns(self) -> tuple[str, ...]:
        """Covariates that images.csv will hold."""
        warm = ("temperature_c",) if self.temperature_c else ()
        return ("time_s", *warm, *(("sweep", "mirror_speed_deg_s") if self.mirror else ()))

    @property
    def causes(self) -> Causes:
        """The effects that are switched on; InputError where one is unknown or lacks its column."""
        rows = [(c.effect, c.where, dict(c.model_extra or {}), c.values) for c in self.effect]
        return make_causes(rows, self.sees, self.columns, len(self.balls))


def read_scene(path: Path) -> Scene:
    """The scene of a TOML file; InputError with the file, the key and what was expected.

    Files that it names are searched for in its folder.
    """
    try:
        keys = read_toml(path)
    except (OSError, ContentError) as problem:
        raise InputError(f"scene {path} cannot be read ({problem}); write it as TOML") from None
    try:
        scene = Scene(**keys)
        _ = scene.board.pattern, scene.causes  # which check what pydantic cannot
    except ValidationError as problem:
        raise InputError(_sentence(path, problem.errors()[0])) from None
    except InputError as problem:
        raise InputError(f"scene {path}: {problem}") from None
    folder = Path(path).parent
    if scene.mesh and not (folder / scene.mesh.file).is_file():
        raise InputError(
            f"scene {path}, key mesh.file: expected a file next to the scene, found no {scene.mesh.file}; "
            "correct the name"
        )
    if scene.mesh:
        scene.mesh.file = str(folder / scene.mesh.file)
    if scene.arm:
        scene.arm = str(folder / scene.arm)
    return scene


def _sentence(path, first) -> str:
    key = ".".join(str(part + 1 if isinstance(part, int) else part) for part in first["loc"])
    problem = first["msg"].removeprefix("Value error, ")
    problem = problem[0].lower() + problem[1:]
    if not key:  # of the file as a whole
        return f"scene {path}: {problem}; correct the scene"
    return f"scene {path}, key {key}: {problem}, found {first['input']!r}; correct or remove it"
