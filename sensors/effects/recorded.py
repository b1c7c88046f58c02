"""Effects that read what images.csv records of each image: time, mirror speed, exposure, or any other column."""

from functools import partial
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from sensors.effects.covariates import Vector, WarmUpLaw, warm_ups
from sensors.effects.optics import Blooming
from workbench.core.covariates import known
from workbench.core.effect import Effect, Grid, Variant
from workbench.core.vocabulary import Covariate

_FINEST = (
    6.0  # frequencies per 2 pi / duration: the phase is then off by at most a quarter of a radian
)
_COARSEST = 3.0  # the same where many frequencies are needed: off by half a radian, which a later fit removes
_MAX_FREQUENCIES = 6000  # frequencies
_KNOWN = ("time_s", "sweep", "mirror_speed_deg_s", *Blooming.needs)


class LaserDrift(WarmUpLaw, Effect):
    """The laser drifts while it warms up: linearly with time, or exponentially with a time constant.

    Its direction turns every light plane as a turn of the mirror does. A laser whose mount bends turns about a place of
    its own, which displaces the light in parallel as well. With `apex_mm`, a place on the mirror's axis in the camera
    frame, and `axis`, its unit vector, both are parameters: the rotation of the light about the mirror's axis, and its
    displacement along the normal of the light plane.
    """

    effect = "laser-drift"
    port = "mirror"
    places = ("laser",)
    needs = ("time_s",)
    equation = (
        "dphi = A g, or dn = A (a x n) g, db = (B - A (a x n).p) g; g = t (in hours) or 1 - exp(-(t - t0) / tau); "
        "a, p = direction of and place on the mirror's axis"
    )
    source = "first-order lag of a warm-up; pointing and positional stability of lasers: ISO 11670"
    reads = needs

    def __init__(
        self,
        where: str,
        time_constant_s: Annotated[float, Field(ge=0)] = 0.0,
        start_s: float = 0.0,
        apex_mm: Vector | None = None,
        axis: Vector | None = None,
    ):
        super().__init__(where, time_constant_s, start_s)
        self.apex_mm, self.axis = apex_mm, axis
        self.is_displaced = apex_mm is not None and axis is not None
        self.port = "plane" if self.is_displaced else "mirror"
        self.components = (0, 1, 2, 3) if self.is_displaced else (0,)

    @classmethod
    def candidates(cls, chain):
        """Linear drift, and warm-up with time constants, of the direction alone and with a displacement."""
        if not chain.places("mirror") or not chain.varies("time_s"):
            return
        times = getattr(chain, "times", ())
        for where in chain.places("laser"):
            yield Variant(cls(where), "linear with time", 0.25)
            yield from warm_ups(cls, where, times, 0.25)
            displaced = partial(cls, apex_mm=list(chain.light), axis=list(chain.light_axis))
            suffix = ", with a displacement"
            yield Variant(displaced(where), f"linear with time{suffix}", 0.25)
            yield from warm_ups(displaced, where, times, 0.25, suffix=suffix)

    def table(self, chain):
        is_warm_up = self.time_constant_s > 0
        name, per, word = ("amplitude", "", "warm-up") if is_warm_up else ("rate", "/h", "drift")
        turned = self.parameter(name, f"rad{per}", 1e-4, f"the laser's {word}")
        if not self.is_displaced:
            return (turned,)
        moved = self.parameter(f"shift_{name}", f"mm{per}", 0.02, f"the laser's {word} in parallel")
        return turned, moved

    def basis(self, state):
        """(1, 1, n) of a mirror's turn, or (2, 4, n) of a light plane's turn and displacement."""
        is_warm_up = self.time_constant_s > 0
        progress = self.progress(state) if is_warm_up else state.covariate("time_s") / 3600.0
        if not self.is_displaced:
            return progress[None, None]
        turn = np.cross(np.array(self.axis, float), state.planes[:3], axisb=0, axisc=0)
        about_axis = np.concatenate([turn, -(np.array(self.apex_mm, float) @ turn)[None]])
        displaced = np.zeros_like(about_axis)
        displaced[3] = np.where(np.isnan(state.planes[3]), 0.0, 1.0)
        return known(np.stack([about_axis, displaced])) * progress


class MirrorVibration(Effect):
    """The mirror, or what carries it, vibrates: its angle oscillates with the time of the images.

    A frequency above half the rate of the images appears at its alias; images at irregular times distinguish the two.
    """

    effect = "mirror-vibration"
    port = "mirror"
    places = ("mirror",)
    needs = ("time_s",)
    equation = "dphi = A cos(w t) + B sin(w t)"
    source = "harmonic motion; least-squares periodogram: Lomb, Astrophys. Space Sci. 39 (1976)"
    reads = needs

    def __init__(self, where: str, angular_frequency: Annotated[float, Field(gt=0)] = 1.0):
        super().__init__(where)
        self.angular_frequency = angular_frequency

    @classmethod
    def candidates(cls, chain):
        """None by itself: frequencies are a grid."""
        return ()

    @classmethod
    def grids(cls, chain):
        """Frequencies (rad/s) from three periods in the recording up to half the rate of the images.

        Pauses between board poses make a recording long, and so the frequencies many: they are then less dense, so
        that the range does not end below the rate of the images.
        """
        times = np.unique(np.asarray(getattr(chain, "times", ()), float))
        if len(times) < 12:
            return
        duration = float(np.ptp(times))
        step = float(np.median(np.diff(times)))
        highest = np.pi / max(step, 1e-9)
        finest, coarsest = (2 * np.pi / (dense * duration) for dense in (_FINEST, _COARSEST))
        spacing = np.clip(highest / _MAX_FREQUENCIES, finest, coarsest)
        highest = min(highest, spacing * _MAX_FREQUENCIES)
        values = np.arange(6 * np.pi / duration, highest, spacing)
        even = np.full(len(values), 1 / max(len(values), 1))
        for where in chain.places("mirror") if len(values) else ():
            label = "{:g} rad/s"
            yield Grid(cls, where, "angular_frequency", "wave", "time_s", values, even, 1e-4, label)

    def option_unit(self, chain, name):
        return "rad/s"

    def table(self, chain):
        return tuple(
            self.parameter(wave, "rad", 1e-4, f"the mirror's vibration, {wave}ine")
            for wave in ("cos", "sin")
        )

    def basis(self, state):
        phase = self.angular_frequency * state.covariate("time_s")
        return np.stack([np.cos(phase), np.sin(phase)])[:, None]


class RollingShutter(Effect):
    """The rows of an image are read one after the other while the mirror rotates."""

    effect = "rolling-shutter"
    port = "mirror"
    places = ("time",)
    needs = ("mirror_speed_deg_s",)
    equation = "dphi = omega * T * (row / height - 1/2)"
    source = "line delay of a rolling shutter: Geyer, Meingast, Sastry, OMNIVIS (2005)"
    reads = ("mirror_speed_deg_s", "v")
    of_session = True

    def table(self, chain):
        return (self.parameter("readout", "s", 1e-3, "the time in which an image is read out"),)

    def basis(self, state):
        row = state.pixels[1] / state.camera.size[1] - 0.5
        return (known(row) * np.deg2rad(state.covariate("mirror_speed_deg_s")))[None, None]


class RecordedColumn(Effect):
    """The stripe moves in proportion to a recorded column that no other effect reads, as exposure time.

    At the mirror it turns all light planes, at the laser it shifts them along their normals. `spread` is the standard
    deviation of the column, by which the size of the parameter is judged.
    """

    effect = "recorded-column"
    port = "mirror"
    places = ("mirror", "laser")
    equation = "dphi = c x at the mirror, db = c x at the laser; x = the column"
    source = "first-order dependence on a covariate"

    def __init__(
        self,
        where: str,
        column: str = "exposure_ms",
        spread: Annotated[float, Field(gt=0)] = 1.0,
    ):
        super().__init__(where)
        self.column, self.spread = column, spread
        self.needs = (column,)
        self.port = "mirror" if where == "mirror" else "plane"
        self.components = (0,) if where == "mirror" else (3,)

    @property
    def reads(self):
        return (self.column,)

    @classmethod
    def candidates(cls, chain):
        """Every recorded column that varies and that no other effect reads, at mirror and laser."""
        columns = {
            name: spread
            for name, spread in getattr(chain, "spreads", ())
            if name not in _KNOWN and Covariate.of(name).kind != "temperature"
        }
        for place in cls.places:
            for where in chain.places(place):
                for name, spread in columns.items():
                    yield Variant(cls(where, name, spread), name, 1 / len(columns))

    def table(self, chain):
        unit, size = ("rad", 1e-4) if self.where == "mirror" else ("mm", 0.02)
        label = f"what one unit of {self.column} moves the stripe by"
        return (self.parameter("slope", f"{unit}/unit", size / self.spread, label),)

    def basis(self, state):
        return state.covariate(self.column)[None, None]


class BoardPointErrors(Effect):
    """One printed row or column of the board's points is displaced in the plane of the board."""

    effect = "board-point-errors"
    port = "target"
    places = ("artefact",)
    components = (0, 1)
    coexists = True
    equation = "dx, dy of all points with y = at_mm (row) or x = at_mm (column)"
    source = "calibration with an inaccurate target: Strobl & Hirzinger, ICCV Workshops (2011)"
    reads = ("board_x", "board_y")

    def __init__(self, where: str, line: Literal["row", "column"] = "row", at_mm: float = 0.0):
        super().__init__(where)
        self.line, self.at_mm = line, at_mm

    @classmethod
    def candidates(cls, chain):
        """Every row and every column of the board."""
        columns, rows = getattr(chain, "board_lines", ((), ()))
        lines = [("column", x) for x in columns] + [("row", y) for y in rows]
        for where in chain.places("artefact"):
            for line, position in lines:
                label = f"{line} at {position:g} mm"
                yield Variant(cls(where, line, float(position)), label, 1 / len(lines))

    def table(self, chain):
        name = f"{self.line}{self.at_mm:g}".replace(".", "p").replace("-", "m")
        return tuple(
            self.parameter(f"{name}_{axis}", "mm", 0.02, f"the {self.line}'s shift in {axis}")
            for axis in "xy"
        )

    def basis(self, state):
        place = state.target[1 if self.line == "row" else 0]
        is_on_line = (np.abs(place - self.at_mm) < 1e-3).astype(float)
        return np.eye(2)[:, :, None] * is_on_line
