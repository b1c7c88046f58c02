"""Tilts that an accelerometer on the machine has measured: of the ground under it, or of a part that bends."""

from typing import Annotated

import numpy as np
from pydantic import StringConstraints

from robot_model.statics import STANDARD_GRAVITY
from workbench.core.effect import Effect, Variant
from workbench.core.vocabulary import Covariate


class MeasuredTilt(Effect):
    """A part of the machine tilts as an accelerometer on it has recorded.

    At the base or at a link; the accelerometer may stand elsewhere. `sensor` is its place as the columns
    accel_<sensor>_x_m_s2 and so on name it, `axes` the two of its axes that lie level. How it is mounted and about
    which point the part tilts is found: six numbers for each of the two.
    """

    effect = "measured-tilt"
    port = "frame"
    places = ("base", "link")
    equation = "twist = C (a1, a2) / g, a1 and a2 the level components of the acceleration"
    source = "an accelerometer at rest is an inclinometer: first order in the angle"
    coexists = True

    def __init__(
        self,
        where: str,
        sensor: str,
        axes: Annotated[str, StringConstraints(pattern=r"^(xy|xz|yz)$")] = "xy",
    ):
        super().__init__(where)
        self.sensor, self.axes = sensor, axes

    @property
    def needs(self) -> tuple[str, ...]:
        """The two columns."""
        return tuple(f"accel_{self.sensor}_{axis}_m_s2" for axis in self.axes)

    @property
    def reads(self) -> tuple[str, ...]:
        return self.needs

    @classmethod
    def candidates(cls, chain):
        """Of the base and every link, by every accelerometer: it measures the tilt of what it is mounted on."""
        covariates = chain.state.covariates
        known = map(Covariate.of, covariates)
        sensors = dict.fromkeys(
            str(covariate.place) for covariate in known if covariate.kind == "acceleration"
        )
        for sensor in sensors:
            axes = level_axes(covariates, sensor)
            if axes is None:
                continue
            for where in (*chain.places("base"), *chain.places("link")):
                label = f"by the accelerometer of the {sensor}"
                yield Variant(cls(where, sensor, axes), label, 1 / len(sensors))

    def table(self, chain):
        # ground that gives way sinks as it tilts: as if about a point many metres off
        components = [(f"d{c}", "mm/rad", 1000.0) for c in "xyz"] + [
            (f"r{c}", "rad/rad", 1.0) for c in "xyz"
        ]
        return tuple(
            self.parameter(
                f"{self.sensor}_{axis}_{name}",
                unit,
                size,
                f"{name} by the accelerometer's {axis}",
                20 * size,
            )
            for axis in self.axes
            for name, unit, size in components
        )

    def basis(self, state):
        angles = np.stack([state.covariate(name) for name in self.needs]) / STANDARD_GRAVITY
        return np.einsum("st,an->astn", np.eye(6), angles).reshape(12, 6, state.n)


def level_axes(covariates, sensor: str) -> str | None:
    """The two axes of an accelerometer across which gravity least lies; None where two are not recorded or rest."""
    components = {axis: covariates.get(f"accel_{sensor}_{axis}_m_s2") for axis in "xyz"}
    level = sorted(
        (float((x**2).mean()), axis)
        for axis, x in components.items()
        if x is not None and np.ptp(x) > 0
    )[:2]
    if len(level) == 2:
        return "".join(sorted(axis for _, axis in level))
    return None


__all__ = ["MeasuredTilt", "level_axes"]
