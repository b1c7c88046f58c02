"""The effects that are switched on in a image, and what they do to each port of the scanner chain."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from sensors.camera.model import Camera
from sensors.effects import CATALOGUE
from sensors.effects.laser import GhostLine
from sensors.state import SensorState
from workbench.core.effect import Effect, make_effects
from workbench.core.errors import InputError
from workbench.core.parameters import Parameter

PORTS = {"pixel": 2, "ray": 3, "mirror": 1, "plane": 5, "point": 3, "target": 3, "noise": 1}
"""Components a sample of each port."""
DRAWN = (GhostLine,)
"""Effects that the renderer draws as light: the law of their port is what they do to the centre of a fitted line."""


@dataclass(frozen=True)
class Causes:
    """Effects with the values (P,) of their parameters; those at one port add up."""

    pairs: tuple[tuple[Effect, np.ndarray], ...] = ()

    def acts_on(self, port: str) -> bool:
        """Whether anything acts on this port."""
        return any(effect.port == port for effect, _ in self.pairs if not isinstance(effect, DRAWN))

    @property
    def ghost_lines(self) -> tuple[tuple[GhostLine, float], ...]:
        """Copies of the laser line, each with its share of the brightness."""
        return tuple((e, float(v[0])) for e, v in self.pairs if isinstance(e, GhostLine))

    def delta(self, port: str, state: SensorState) -> np.ndarray:
        """(components, n) change of the port's components at the samples of `state`; 0 where nothing acts."""
        total = np.zeros((PORTS[port], state.n))
        for effect, values in self.pairs:
            if effect.port == port and not isinstance(effect, DRAWN):
                total[list(effect.port_indices(_Numbering(state)))] += effect.delta(values, state)
        return total


@dataclass(frozen=True)
class _Numbering:
    """Numbering of the scanner's ports, as effects request it of a chain."""

    state: SensorState
    balls: int = 0

    def port_indices(self, port, where, components):
        return components or tuple(range(PORTS[port]))

    def numbers(self, place):
        return tuple(range(1, self.balls + 1))


def make_causes(
    rows: Iterable[tuple[str, str, Mapping, Mapping]],
    camera: Camera,
    covariates: Iterable[str],
    balls: int,
) -> Causes:
    """From (effect, where, options, values) rows; values by the last part of a parameter's key.

    covariates: names of the columns that the images will have; balls: how many there are.
    Raises InputError for an unknown effect, place, option, parameter, or a column that is missing.
    """
    rows = list(rows)
    effects = make_effects(
        CATALOGUE, [(name, where, dict(options)) for name, where, options, _ in rows]
    )
    chain = _Numbering(blank_state(camera, 1, dict.fromkeys(covariates, 0.0)), balls)
    pairs = [
        (e, _values(e.parameters(chain), values, e.title)) for e, (*_, values) in zip(effects, rows)
    ]
    for effect in effects:
        for need in effect.needs:
            chain.state.covariate(need)
    return Causes(tuple(pairs))


def _values(table: tuple[Parameter, ...], values: Mapping[str, float], title: str) -> np.ndarray:
    names = [parameter.key.rpartition(".")[2] for parameter in table]
    for name in values:
        if name not in names:
            raise InputError(
                f"effect {title}, key values: expected {', '.join(names)}, found {name}; correct the name"
            )
    return np.array([float(values.get(name, 0.0)) for name in names])


def blank_state(camera: Camera, n: int, covariates: Mapping[str, float], **known) -> SensorState:
    """n observations of which only `known` (fields of SensorState) is known; covariates the same for all."""
    nothing = {"pixels": 2, "points": 3, "planes": 4, "board": 2, "normals": 3, "target": 3}
    fields = {name: np.broadcast_to(np.nan, (rows, n)) for name, rows in nothing.items()}
    fields |= {"mirror": np.broadcast_to(np.nan, n), "ball": np.broadcast_to(0, n)} | known
    return SensorState(
        camera,
        covariates={k: np.broadcast_to(float(v), n) for k, v in covariates.items()},
        **fields,
    )


@dataclass(frozen=True)
class Moment:
    """Conditions of an image: the effects, the covariates' values at that instant, and the depth (mm) on
    which the lens is focused, nan where no effect asks for it."""

    causes: Causes = Causes()
    covariates: Mapping[str, float] = field(default_factory=dict)
    focus: float = np.nan

    def state(self, camera: Camera, n: int, **known) -> SensorState:
        """n observations at this moment."""
        known = {"focus": np.broadcast_to(self.focus, n)} | known
        return blank_state(camera, n, self.covariates, **known)
