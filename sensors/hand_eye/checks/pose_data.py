"""Data, freedom and result of a hand-eye fit to board poses; see `pose_fit`."""

from dataclasses import dataclass

import numpy as np

_KEPT = 0.75


@dataclass(frozen=True)
class PoseData:
    """Flange poses and what the camera saw.

    `moved` (P, 4, 4) the M_i above, mm. `seen` (T, P, 4, 4) T_camera_board under each of the T ways in which the board
    can be labelled (1 unless the board looks the same after a rotation). `corners` (3, 4) mm on the board.
    """

    moved: np.ndarray
    seen: np.ndarray
    corners: np.ndarray

    @property
    def count(self) -> int:
        """Number of images."""
        return len(self.moved)


@dataclass(frozen=True)
class Freedom:
    """Parameters that are estimated besides one sensor pose and one board pose.

    `scale`: a common factor of all flange positions. `sensor_from`, `board_from`: number of the image from which on
    the sensor, or the board, has another pose.
    """

    scale: bool = False
    sensor_from: int | None = None
    board_from: int | None = None

    @property
    def number(self) -> int:
        """Parameters in all."""
        return (
            12 + self.scale + 6 * (self.sensor_from is not None) + 6 * (self.board_from is not None)
        )


@dataclass(frozen=True)
class PoseFit:
    """A fit: `sensor` and `board` (S, 4, 4), one per segment; `scale` of the flange positions with its standard
    deviation; `distance` (P,) RMS of the four corners of each image, mm; `labels` (P,) in 0..T-1; `freedom`."""

    sensor: np.ndarray
    board: np.ndarray
    scale: float
    scale_std: float
    distance: np.ndarray
    labels: np.ndarray
    freedom: Freedom

    @property
    def degrees(self) -> int:
        """Degrees of freedom: six numbers per image less the parameters; at least 1."""
        return max(6 * len(self.distance) - self.freedom.number, 1)

    @property
    def rms(self) -> float:
        """mm, RMS distance, corrected for the parameters estimated."""
        return float(np.sqrt((self.distance**2).sum() * 6 / self.degrees))

    @property
    def trimmed_rms(self) -> float:
        """mm, the same of the three quarters of the images that fit best: a few wrong images do not change it."""
        smallest = np.sort(self.distance)[: kept_images(len(self.distance))]
        degrees = max(6 * len(smallest) - self.freedom.number, 1)
        return float(np.sqrt((smallest**2).sum() * 6 / degrees))


def kept_images(count: int) -> int:
    """Number of the `count` images that enter the trimmed RMS."""
    return max(int(np.ceil(_KEPT * count)), min(count, 3))
