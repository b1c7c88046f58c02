"""The true instrument that is rendered: camera, optics, chip, laser and mirror."""

from dataclasses import dataclass, field

import numpy as np

from sensors.camera.model import Camera
from sensors.light.mirror import Mirror
from sensors.rendering.ports import Moment


@dataclass(frozen=True)
class Optics:
    """The lens's blur, in addition to its distortion: a Gaussian of 1 sigma `blur_px` at the distance `focus_mm`.

    Away from there it grows as a thin lens's circle of confusion does (Potmesil & Chakravarty,
    SIGGRAPH 1981, eq. 1): its 1 sigma is `defocus_px` times |1 - focus / z|.
    """

    blur_px: float = 0.6
    focus_mm: float = 125.0
    defocus_px: float = 8.0
    vignetting: float = 0.0
    """Power of the cosine of the field angle by which the light falls; 4 is the natural law of a thin lens."""

    def sigma(self, depth: np.ndarray) -> np.ndarray:
        """Blur's 1 sigma in px at depths z in mm, any shape; nan (nothing there) counts as in focus."""
        defocus = np.nan_to_num(1 - self.focus_mm / np.asarray(depth, float))
        return np.hypot(self.blur_px, self.defocus_px * defocus)


@dataclass(frozen=True)
class Chip:
    """From electrons to numbers. EMVA 1288's linear model: photon noise, read noise, saturation, quantisation.

    A image of `bits` up to 8 is uint8, above uint16; 10 and 12 bits fill the upper bits of the
    16, so that white is 65520 or more whatever the depth. `black` is a share of full scale.
    """

    full_well_e: float = 10_000.0
    read_noise_e: float = 12.0
    black: float = 0.01
    bits: int = 8
    blooming: float = 0.0
    """Share of the charge beyond the full well that spills along the columns; the rest is drained."""
    spill_px: float = 3.0
    """Distance over which the spilled charge falls to 1/e."""

    @property
    def top(self) -> int:
        """Largest number that the converter gives."""
        return 2**self.bits - 1

    @property
    def scale(self) -> int:
        """Size of a step of the converter in the file."""
        return 1 if self.bits <= 8 else 2 ** (16 - self.bits)


@dataclass(frozen=True)
class Laser:
    """The light plane: Gaussian across, 1 sigma `width_mm`; what a white surface gives back.

    `peak` (share of the full well) of a white surface square to the light, at the distance
    `reach_mm` from where the light fans out; it falls with the distance from there. `source` (3,)
    mm, that place before the mirror, camera frame (for a fixed light plane: the place itself), None for
    light from so far that it casts no shadow. Speckle: a multiplying field with mean 1, standard deviation
    `contrast` and Gaussian grains of 1 sigma `grain_px`.
    """

    width_mm: float = 0.06
    peak: float = 0.7
    reach_mm: float = 200.0
    source: np.ndarray | None = None
    contrast: float = 0.1
    grain_px: float = 0.8
    rayleigh_mm: float = float("inf")
    """Distance from the waist, at `reach_mm`, where the line is wider by the root of two (a Gaussian beam)."""
    uneven: float = 0.0
    """Amplitude of brightness along the fan, as a share."""
    uneven_deg: float = 5.0
    """Period of that brightness, an angle of the fan."""
    indirect: float = 0.0
    """Share of the light that surfaces throw onto one another, 1 as it is: `sensors.rendering.indirect`."""

    def width(self, distance: np.ndarray) -> np.ndarray:
        """(n,) mm, 1 sigma of the line at distances (n,) mm from the source: Siegman, Lasers (1986), ch. 17."""
        return self.width_mm * np.hypot(1, (distance - self.reach_mm) / self.rayleigh_mm)


@dataclass(frozen=True)
class Lamp:
    """Light that is not the laser's, as shares of the full well from a white surface: a lamp at the camera."""

    board: float = 0.7
    laser: float = 0.01
    background: float = 0.05
    """How white what lies behind everything is."""
    towards: tuple[float, float, float] | None = None
    """Direction towards a distant lamp, camera frame; None for a lamp at the camera."""


@dataclass(frozen=True)
class Instrument:
    """Everything about the scanner that is true. `steps` (S,) int, `angles` (S,) rad of the mirror as commanded.

    `planes` (4, S) where there is no mirror: unit normals and offsets in mm, camera frame.
    """

    camera: Camera
    steps: np.ndarray
    angles: np.ndarray | None = None
    mirror: Mirror | None = None
    planes: np.ndarray | None = None
    optics: Optics = field(default_factory=Optics)
    chip: Chip = field(default_factory=Chip)
    laser: Laser = field(default_factory=Laser)
    lamp: Lamp = field(default_factory=Lamp)

    def nominal_planes(self) -> np.ndarray:
        """(4, S) light planes as they are without effects."""
        return self.planes if self.mirror is None else self.mirror.planes(self.angles)

    @property
    def commanded(self) -> np.ndarray:
        """(S,) rad, 0 where there is no mirror."""
        return np.zeros(len(self.steps)) if self.angles is None else self.angles

    def light_planes(self, state, moment: Moment) -> np.ndarray:
        """(5, n) normal, offset and curvature of the light plane at each observation of `state`."""
        flat = self._flat_planes(state, moment.causes)
        planes = np.vstack([flat, np.zeros(state.n)])
        if moment.causes.acts_on("plane"):
            return planes + moment.causes.delta("plane", state)
        return planes

    def _flat_planes(self, state, causes) -> np.ndarray:
        """(4, n) planes of the mirror at the angles that it really has."""
        if self.mirror is None or not causes.acts_on("mirror"):
            return state.planes
        return self.mirror.planes(state.mirror + causes.delta("mirror", state)[0])

    def light(self, index: int) -> np.ndarray | None:
        """(3,) mm where the light of a step seems to come from: the source's image in the mirror."""
        source, mirror = self.laser.source, self.mirror
        if source is None or mirror is None:
            return source
        face = mirror.normals(self.angles[index : index + 1])[:, 0]
        past_mirror = face @ (source - mirror.point) - mirror.offset
        return source - 2 * past_mirror * face


def sweeping_mirror(
    baseline_mm: float,
    aim_mm: float,
    offset_mm: float,
    distance_mm: float,
    tilt_deg: tuple[float, float] = (0.0, 0.0),
) -> tuple[Mirror, np.ndarray]:
    """A mirror next to the camera that throws a light plane, standing along the image's columns, to z = `aim_mm`.

    Its axis goes through (baseline, 0, 0) along y, turned by `tilt_deg` about x and z; the light
    comes from `distance_mm` beyond it along x. Returns the mirror and the source (3,) mm.
    """
    point = np.array([baseline_mm, 0.0, 0.0])
    displacement = np.array([-baseline_mm, 0.0, aim_mm]) / np.hypot(baseline_mm, aim_mm)
    coming = np.array([-1.0, 0.0, 0.0])
    tilt_x, tilt_z = np.deg2rad(tilt_deg)
    axis = np.array([-np.sin(tilt_z), 1.0, np.sin(tilt_x)])
    axis /= np.linalg.norm(axis)
    face = displacement - coming
    face -= axis * (axis @ face)
    beam = np.array([0.0, 0.0, 1.0, 0.0])
    mirror = Mirror(axis, point, face / np.linalg.norm(face), offset_mm, beam)
    return mirror, point - distance_mm * coming
