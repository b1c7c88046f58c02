"""The sensor's candidates and the places where a smooth nonparametric function may act, of a scanner's measurements.

Nothing here looks at a residual: only at which kinds of measurement there are, and which columns.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sensors.effects.optics import Blooming


@dataclass(frozen=True)
class Place:
    """Some components of a port at a place, which a smooth function of `covariates` (one, or two of `pairs`) moves."""

    where: str
    port: str
    port_indices: tuple[int, ...]
    unit: str
    typical: float
    covariates: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Kind:
    """Contents of a recording of a scanner; implements `workbench.core.effect.Recorded`.

    `stripes`: whether it has any; `mirror`: whether the angles of a mirror are known, and `mirror_angles` (S,) rad
    those of the steps; `balls`: numbers of the balls, 0 for one without a number; `varying`: recorded columns that are
    not constant, and `spreads` their standard deviations in the images with the laser; `times` (s) of these images;
    `board_lines`: x of the columns and y of the rows of the board's points (mm); `light` (3,) mm: a place on the
    mirror's axis, from which the light comes, and `light_axis` (3,) the axis' unit vector, camera frame; `depth_mm`
    mean depth of the boards; `line_along`: "rows" or "columns" of the image, in which centres were measured.
    """

    stripes: bool
    mirror: bool
    balls: tuple[int, ...]
    varying: frozenset[str]
    light: tuple[float, float, float] | None = None
    light_axis: tuple[float, float, float] | None = None
    mirror_angles: tuple[float, ...] = ()
    spreads: tuple[tuple[str, float], ...] = ()
    times: tuple[float, ...] = ()
    board_lines: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())
    depth_mm: float = 0.0
    line_along: str = "rows"

    def places(self, kind: str) -> tuple[str, ...]:
        """Values of `where` of an effect on this recording; () if there is no such place."""
        if kind == "ball":
            return tuple(f"ball-{number}" for number in self.balls if number)
        present = {
            "laser": self.stripes,
            "sensor": self.stripes,
            "mirror": self.mirror,
            "time": self.mirror,
        }
        return (kind,) if present.get(kind, True) else ()

    def varies(self, covariate: str) -> bool:
        """Whether a column is recorded and is not constant."""
        return covariate in self.varying

    def slides(self, joint: int) -> bool:
        """A scanner has no prismatic joints."""
        return False


def places(kind: Kind) -> list[Place]:
    """Places of smooth alternatives; a recorded column without a model is tested at every place."""
    recorded = tuple(sorted(kind.varying - {"sweep", "mirror_speed_deg_s", *Blooming.needs}))
    turning = tuple(sorted(kind.varying & {"sweep", "mirror_speed_deg_s"}))
    found = [
        Place("camera", "pixel", (0, 1), "px", 0.05, ("u", "v", *recorded), (("u", "v"),)),
        Place(
            "artefact",
            "target",
            (2,),
            "mm",
            0.05,
            ("board_x", "board_y", *recorded),
            (("board_x", "board_y"),),
        ),
    ]
    if kind.stripes:
        found.append(
            Place(
                "laser",
                "plane",
                (3,),
                "mm",
                0.02,
                ("along", "range", *recorded),
                (("along", "range"),),
            )
        )
        found.append(
            Place(
                "sensor",
                "point",
                (2,),
                "mm",
                0.02,
                ("range", "incidence", "u", "v", *recorded),
                (("u", "v"), ("range", "v")),
            )
        )
    if kind.mirror:
        found.append(Place("mirror", "mirror", (0,), "rad", 1e-4, ("mirror", *turning, *recorded)))
        found.append(
            Place("mirror", "plane", (3,), "mm", 0.02, ("mirror",), (("mirror", "along"),))
        )
    return found


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
        "along": np.zeros(state.n) if kind_of == "corners" else state.stripe_place,
        "board_x": np.nan_to_num(state.board[0]),
        "board_y": np.nan_to_num(state.board[1]),
    }
    return {**chain.covariates, **known}


def samples_described(chain, kind_of: str) -> Mapping[str, np.ndarray]:
    """(n,) bool: which samples have a covariate of their own, where `described` fills in a value for the others."""
    state = chain.state
    return {
        "mirror": ~np.isnan(state.mirror),
        "along": np.full(state.n, kind_of != "corners"),
        "board_x": ~np.isnan(state.board[0]),
        "board_y": ~np.isnan(state.board[1]),
    }
