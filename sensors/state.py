"""State of n observations for the effects of the sensor: place in the field, distance, incidence, time."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sensors.camera.model import Camera
from workbench.core.errors import InputError


@dataclass(frozen=True)
class SensorState:
    """n observations of a scanner, at nominal values; what an observation does not have is nan.

    `pixels` (2, n) as expected at the start, px: a function of the observed ones would contain their noise, and fit
    itself to it; `points` (3, n) mm where the surface was seen, camera frame;
    `planes` (4, n) light plane of each, `mirror` (n,) rad; `board` (2, n) place on the board from
    its middle over half its diagonal; `normals` (3, n) unit normal of the surface, camera frame;
    `ball` (n,) number of the ball, 0 for none; `covariates` by the name of their column;
    `target` (3, n) mm nominal place on the board, board frame, or of the ball, artefact frame; `focus` (n,) mm depth on
    which the lens was focused in the image of each, None where the observations are of one image or scan.
    """

    camera: Camera
    pixels: np.ndarray
    points: np.ndarray
    planes: np.ndarray
    mirror: np.ndarray
    board: np.ndarray
    normals: np.ndarray
    ball: np.ndarray
    covariates: Mapping[str, np.ndarray] = field(default_factory=dict)
    target: np.ndarray | None = None
    focus: np.ndarray | None = None
    in_order = (
        False  # images may be listed in any order: without a clock nothing stands in for time
    )

    @property
    def n(self) -> int:
        return self.pixels.shape[1]

    @property
    def field(self) -> np.ndarray:
        """(2, n) place in the image, from its middle over half its diagonal: within the unit circle."""
        width, height = self.camera.size
        middle = np.array([[(width - 1) / 2], [(height - 1) / 2]])
        return 2 * (self.pixels - middle) / np.hypot(width, height)

    @property
    def focus_depth(self) -> np.ndarray:
        """(n,) mm, one for each image: a lens has one focal length, on whatever part of the object it is focused."""
        if self.focus is not None:
            return self.focus
        known = self.points[2][np.isfinite(self.points[2])]
        return np.full(self.n, known.mean() if known.size else np.nan)

    @property
    def rays(self) -> np.ndarray:
        """(3, n) unit directions from the camera to the points."""
        return self.points / np.linalg.norm(self.points, axis=0)

    @property
    def incidence(self) -> np.ndarray:
        """(n,) rad, between the surface's normal and the way back to the camera."""
        return np.arccos(np.clip(np.abs((self.rays * self.normals).sum(0)), 0, 1))

    @property
    def stripe_place(self) -> np.ndarray:
        """(n,) mm, place along the stripe: across the optical axis, within the light plane."""
        return (stripe_direction(self.planes) * self.points).sum(0)

    def covariate(self, name: str) -> np.ndarray:
        """(n,) a column that must have been recorded, or incidence, range and place of the observation itself.

        InputError for a column that was not recorded.
        """
        if name in OF_THE_OBSERVATION:
            return OF_THE_OBSERVATION[name](self)
        if name not in self.covariates:
            raise InputError(
                f"images.csv: expected a column {name}, found none; record it or take the effect out"
            )
        return self.covariates[name]


OF_THE_OBSERVATION = {
    "incidence_deg": lambda state: np.rad2deg(state.incidence),
    "range_mm": lambda state: np.linalg.norm(state.points, axis=0),
    "u_px": lambda state: state.pixels[0],
    "v_px": lambda state: state.pixels[1],
}
"""Covariates that the state gives without a column, by name."""


def stripe_direction(planes: np.ndarray) -> np.ndarray:
    """(3, n) unit direction within light planes (4, n), across the camera's optical axis."""
    direction = np.stack([planes[1], -planes[0], np.zeros_like(planes[0])])
    return direction / np.linalg.norm(direction, axis=0)
