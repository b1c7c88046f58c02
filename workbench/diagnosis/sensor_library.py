"""The sensor's candidates and the places where something without a name may act, of a scanner's measurements.

Nothing here looks at a residual: only at which kinds of measurement there are, and which columns.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sensors.effects import CATALOGUE
from workbench.core.effect import Effect

CLOCK = ("temperature_c", "time_s")
_ORDERS = tuple(range(1, 9))


@dataclass(frozen=True)
class Option:
    """An effect, how it is told from its variants, its family and share of it, and what is missing."""

    effect: Effect
    label: str
    family: str
    mass: float = 1.0
    missing: str = ""


@dataclass(frozen=True)
class Place:
    """Some slots of a port at a place, which an unnamed function of `covariates` (one, or two of `pairs`) moves."""

    where: str
    port: str
    slots: tuple[int, ...]
    unit: str
    typical: float
    covariates: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Kind:
    """What a recording holds: `stripes`, a `mirror` whose angles are known, numbers of `balls`, columns that vary."""

    stripes: bool
    mirror: bool
    balls: tuple[int, ...]
    varies: frozenset[str]
    light: tuple[float, float, float] | None = None


def options(kind: Kind) -> list[Option]:
    """All named candidates."""
    made = [*_camera(kind), _option("board-bow", "artefact")]
    if kind.varies & set(CLOCK):
        made.append(_option("artefact-expansion", "artefact", missing=_missing(kind)))
    if kind.stripes:
        made += _light(kind)
    return made


def _option(name, where, label="", mass=1.0, missing="", **given) -> Option:
    return Option(CATALOGUE[name](where, **given), label, f"{name} {where}", mass, missing)


def _missing(kind):
    return "" if any(name.startswith("temperature") for name in kind.varies) else "temperature"


def _camera(kind):
    yield _option("lens-residual", "camera", "third degree", 0.5)
    yield _option("lens-residual", "camera", "fourth degree", 0.5, degree=4)
    yield _option("window-refraction", "camera")
    if kind.varies & set(CLOCK):
        yield _option("camera-thermal-drift", "camera", missing=_missing(kind))


def _light(kind):
    yield _option("plane-bow", "laser", "the same all along", 0.5)
    if kind.light is not None:
        yield _option(
            "plane-bow", "laser", "fanning out from the mirror", 0.5, apex_mm=list(kind.light)
        )
    yield _option("incidence-bias", "sensor")
    if kind.balls:
        yield _option("range-scale", "sensor")
        yield _option("subsurface-scatter", "sensor")
        for number in kind.balls:
            if number:
                yield _option("ball-radius", f"ball-{number}")
    if kind.mirror:
        yield from _mirror(kind)


def _mirror(kind):
    yield _option("mirror-wobble", "mirror")
    for order in _ORDERS:
        yield _option(
            "mirror-encoder-harmonic", "mirror", f"order {order}", 1 / len(_ORDERS), order=order
        )
    if "sweep" in kind.varies:
        yield _option("mirror-hysteresis", "mirror")
    if "mirror_speed_deg_s" in kind.varies:
        yield _option("frame-sync", "time")


def places(kind: Kind) -> list[Place]:
    """Where something unnamed may act; a column nobody modelled may matter anywhere."""
    more = tuple(sorted(kind.varies - {"sweep", "mirror_speed_deg_s"}))
    turning = tuple(sorted(kind.varies & {"sweep", "mirror_speed_deg_s"}))
    made = [
        Place("camera", "pixel", (0, 1), "px", 0.05, ("u", "v", *more), (("u", "v"),)),
        Place(
            "artefact",
            "target",
            (2,),
            "mm",
            0.05,
            ("board_x", "board_y", *more),
            (("board_x", "board_y"),),
        ),
    ]
    if kind.stripes:
        made.append(
            Place(
                "laser", "plane", (3,), "mm", 0.02, ("along", "range", *more), (("along", "range"),)
            )
        )
        made.append(
            Place(
                "sensor",
                "point",
                (2,),
                "mm",
                0.02,
                ("range", "incidence", "u", "v", *more),
                (("u", "v"), ("range", "v")),
            )
        )
    if kind.mirror:
        made.append(Place("mirror", "mirror", (0,), "rad", 1e-4, ("mirror", *turning, *more)))
        made.append(Place("mirror", "plane", (3,), "mm", 0.02, ("mirror",), (("mirror", "along"),)))
    return made


def described(chain, kind_of: str, mirror: float) -> Mapping[str, np.ndarray]:
    """(n,) covariates of a chain's samples: as recorded, and what follows from the place.

    `mirror` rad stands in where a sample has no mirror angle. `u`, `v` px; `along`, `range` mm; `incidence` rad;
    `board_x`, `board_y` from the board's middle over half its diagonal.
    """
    state = chain.state
    known = {
        "u": state.pixels[0],
        "v": state.pixels[1],
        "range": state.points[2],
        "incidence": state.incidence,
        "mirror": np.where(np.isnan(state.mirror), mirror, state.mirror),
        "along": np.zeros(state.n) if kind_of == "corners" else state.along,
        "board_x": np.nan_to_num(state.board[0]),
        "board_y": np.nan_to_num(state.board[1]),
    }
    return {**chain.covariates, **known}
