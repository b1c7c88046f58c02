"""Scans of balls by a sensor on the flange, each one sample: what all points of a scan say about the ball's place.

A displacement e of the ball in the sensor frame changes the radial distances of a scan's points, of a profile those
from its circle in the light plane, by H e, to first order. All that depends on the pose alone reaches the points
through these three numbers, and the m distances of a scan say no more about them than G^(1/2) e does, with G = H'H / m
(sufficient statistic of a linear model). Its three components have equal variances where the noise of the points is
independent, and its length is the RMS over the scan's points of the radial distance that the displacement makes.
"""

from dataclasses import dataclass, replace

import numpy as np

from datasets.recording import ROOT, SECTION
from robot_model.chain import Frames
from robot_model.measurements.ball_centre import BallCentre
from robot_model.measurements.closure import Closure
from robot_model.measurements.multistart import RotationSystem
from workbench.core.parameters import Parameter

KIND = "ball-scan"
"""Of samples that are scans; the file that they come from is of the kind `FILE_KIND`."""
FILE_KIND = "ball-surface"

_SMALLEST_SECTION = 0.05  # of the ball's radius
_LEAST_SEEN = 0.1  # of the largest: displacements that change the distances less are not drawn


def file_kind(measures: str) -> str:
    """The kind of the file from which samples of a kind come."""
    return FILE_KIND if measures == KIND else measures


@dataclass(frozen=True)
class BallScan:
    """n scans: `balls` their centres as seen (of a profile: of its circle), mm; `radius` (n,) of the ball, mm.

    `section` (n,) mm: radius of a profile's circle, nan of a cloud; `root` (n, 3, 3): G^(1/2).
    """

    balls: BallCentre
    radius: np.ndarray
    section: np.ndarray
    root: np.ndarray
    place = "sensor"
    grounded = False

    @classmethod
    def of(cls, recording) -> "BallScan":
        """From a recording of scans with an artefact, as of `workbench.fitting.ball_scans`."""
        columns = recording.columns
        root = np.stack([columns[name] for name in ROOT], axis=1).reshape(-1, 3, 3)
        radius = np.array([recording.balls[int(number)][3] for number in recording.ball])
        return cls(BallCentre.of(recording), radius, columns[SECTION], root)

    @property
    def measured(self) -> np.ndarray:
        """(3, n) mm, centre of the ball in the sensor frame."""
        return self.balls.measured

    @property
    def index(self) -> np.ndarray:
        """(n,) which of `ids` each scan shows."""
        return self.balls.index

    @property
    def ids(self) -> tuple[int, ...]:
        """Numbers of the balls, as in the file."""
        return self.balls.ids

    @property
    def numbers(self) -> np.ndarray:
        """(n,) number of the ball of each scan, as in the file."""
        return self.balls.numbers

    def parameters(self) -> list[Parameter]:
        """Hand-eye transform T_flange_sensor."""
        return self.balls.parameters()

    def targets(self, values: np.ndarray) -> np.ndarray:
        """(3, n) nominal places of the balls on the artefact, mm."""
        return self.balls.targets(values)

    def sigma(self, recording) -> np.ndarray:
        """(3, n) mm; 1 where the recording does not say, and the solve then estimates it."""
        return self.balls.sigma(recording)

    def at(self, samples: np.ndarray) -> "BallScan":
        return replace(
            self,
            balls=self.balls.at(samples),
            radius=self.radius[samples],
            section=self.section[samples],
            root=self.root[samples],
        )

    def close(self, frames: Frames, values: np.ndarray, deltas: dict) -> Closure:
        """G^(1/2) times the displacement (3, n) of the predicted ball from the measured one; the world is the artefact.

        A profile does not show how far its plane is from the centre, but the square of it: across the plane the
        displacement is that of the surface, (y^2 + r^2 - R^2) / (2 R), with the circle's radius r and the ball's R.
        """
        centres = self.balls.close(frames, values, deltas)
        displacement = centres.residual.copy()
        is_profile = np.isfinite(self.section)
        y = (centres.residual + self.measured)[1]
        off_surface = (y**2 + self.section**2 - self.radius**2) / (2 * self.radius)
        displacement[1] = np.where(is_profile, off_surface, displacement[1])
        by_centre = self.place_factor(y)

        def scaled(rows):
            return np.einsum("nij,kjn->kin", by_centre, rows)

        seen = np.linalg.pinv(by_centre, rcond=_LEAST_SEEN)
        port_rows = {port: scaled(rows) for port, rows in centres.port_rows.items()}
        return Closure(
            np.einsum("nij,jn->in", self.root, displacement),
            centres.point,
            lambda rows: scaled(centres.map_rows(rows)),
            scaled(centres.tool_rows),
            port_rows,
            to_world=lambda gap: centres.to_world(np.einsum("nij,jn->in", seen, gap)),
        )

    def place_factor(self, y: np.ndarray) -> np.ndarray:
        """(n, 3, 3) M with the residual M e for a displacement e (mm) of the ball; y (n,) mm of its centre."""
        factor = self.root.copy()
        factor[:, :, 1] *= np.where(np.isfinite(self.section), y / self.radius, 1.0)[:, None]
        return factor

    def start(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """Base pose (6,) and hand-eye (6,), as for ball centres."""
        return self.balls.start(frames)

    def system(self, frames: Frames) -> RotationSystem:
        """The equations of `start`, one sample a scan."""
        return self.balls.system(frames)

    def columns(self, residual: np.ndarray) -> dict[str, np.ndarray]:
        """Columns of samples.csv for what was predicted: the measurement plus its residual (3, n)."""
        displacement = np.linalg.solve(self.root, residual.T[:, :, None])[..., 0].T
        square = self.section**2 - 2 * self.radius * displacement[1]
        section = np.sqrt(np.maximum(square, (_SMALLEST_SECTION * self.radius) ** 2))
        y = np.sqrt(np.maximum(self.radius**2 - section**2, 0)) * np.sign(self.measured[1])
        centre = self.measured + displacement
        centre[1] = np.where(np.isfinite(self.section), y, centre[1])
        return {**dict(zip(("x_mm", "y_mm", "z_mm"), centre)), SECTION: section}
