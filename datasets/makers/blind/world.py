"""The true arm at its workplace, in which a blind case is measured.

Lengths mm, angles rad, samples first: (n, 3). `joint K` counts from 1; a joint's angle is what its
reading becomes after sign and coupling.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from datasets.makers.blind import statics
from datasets.makers.mujoco_arm import Arm, ball_points, reflector_points


@dataclass(frozen=True)
class Perturbation:
    """Changes of a measurement by effects; they are additive, and 0 means no change.

    joint: (n, J) rad on the joint angles. joint_compliance, link_compliance (J,), pedestal (2,)
    rad/(N m). gravity: (3,) added to the direction of gravity. growth: (n, J) share by which the
    length of each link grows. run_out: (n, J, 3) mm by which a joint's axis stands aside, in the
    frame before it. bend: (n, J, 2) rad about the two axes across each link, at its middle. base:
    (n, 6) mm and rad, of the base against the world. tip: (n, 3) mm of the measured point in the
    flange frame. ball: (n, 3) mm of the ball in the artefact frame. sensed: (n, 3) mm in the frame
    of the measurement. spread: (n,) of the logarithm of sigma.
    """

    joint: np.ndarray | float = 0.0
    joint_compliance: np.ndarray | float = 0.0
    link_compliance: np.ndarray | float = 0.0
    pedestal: np.ndarray | float = 0.0
    gravity: np.ndarray | float = 0.0
    growth: np.ndarray | float = 0.0
    run_out: np.ndarray | float = 0.0
    bend: np.ndarray | float = 0.0
    base: np.ndarray | float = 0.0
    tip: np.ndarray | float = 0.0
    ball: np.ndarray | float = 0.0
    sensed: np.ndarray | float = 0.0
    spread: np.ndarray | float = 0.0

    def __add__(self, other: "Perturbation") -> "Perturbation":
        return Perturbation(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))


@dataclass(frozen=True)
class World:
    """The arm as built and where it works.

    robot: the manual's mapping. arm: the arm as built. readings: (n, J) rad. index: (n,) which ball
    or reflector, from 0. targets: (B, 3) mm, balls on the artefact or reflectors on the flange.
    station: (4, 4) artefact or instrument of the base frame; hand: (4, 4) sensor in the flange.
    covariates: columns of samples.csv in file units. elastic: the joints are compliant, also in the baseline.
    part: (n,) True in the part of the workspace, payload or temperature that is withheld from a fit.
    """

    robot: Mapping
    measures: str
    arm: Arm
    readings: np.ndarray
    index: np.ndarray
    targets: np.ndarray
    station: np.ndarray
    hand: np.ndarray
    covariates: Mapping[str, np.ndarray]
    sigma: float
    elastic: bool
    part: np.ndarray

    @property
    def n(self) -> int:
        return len(self.readings)

    @property
    def joints(self) -> int:
        return self.readings.shape[1]

    @cached_property
    def angles(self) -> np.ndarray:
        """(n, J) rad: readings after sign and coupling."""
        return self.readings @ self.arm.mixing.T

    @cached_property
    def payload(self) -> np.ndarray:
        """(n,) kg beyond the tool."""
        return self.covariates.get("payload_kg", np.zeros(self.n))

    @cached_property
    def torque(self) -> np.ndarray:
        """(n, J) N m that gravity puts on every joint."""
        return statics.torques(self.arm, self.angles, self.payload)[0]

    @cached_property
    def moment(self) -> np.ndarray:
        """(n, J, 2) N m across every link at its middle."""
        return statics.torques(self.arm, self.angles, self.payload)[1]

    @cached_property
    def clean(self) -> np.ndarray:
        """(n, 3) mm: the measurement without any effect and without noise."""
        return self.measured(Perturbation())

    def only(self, rows: np.ndarray) -> "World":
        """The same world with only some of its samples; rows (n,) bool."""
        return replace(
            self,
            readings=self.readings[rows],
            index=self.index[rows],
            part=self.part[rows],
            covariates={name: column[rows] for name, column in self.covariates.items()},
        )

    def flange(self, push: Perturbation) -> np.ndarray:
        """(n, 4, 4) of the flange in the frame in which the base once stood."""
        return statics.stand(self.arm, self.angles, self.payload, push)

    def measured(self, push: Perturbation) -> np.ndarray:
        """(n, 3) mm: ball centres in the sensor frame, or reflectors in the instrument's."""
        seen = self.seen(self.flange(push), self.hand, self.targets[self.index], self.station, push)
        return seen + push.sensed

    def seen(self, flange, hand, targets, station, push: Perturbation | None = None) -> np.ndarray:
        """(n, 3) mm for given flange poses, hand-eye, targets (n, 3) and station."""
        tip, ball = (0.0, 0.0) if push is None else (push.tip, push.ball)
        if self.measures == "ball-centre":
            moved = flange.copy()
            moved[:, :3, 3] += np.einsum(
                "nij,nj->ni", flange[:, :3, :3], np.broadcast_to(tip, (len(flange), 3))
            )
            return ball_points(moved, targets + ball, station, hand)
        displaced = flange.copy()
        displaced[:, :3, 3] += np.einsum("nij,nj->ni", flange[:, :3, :3], targets + tip)
        return reflector_points(displaced, np.zeros(3), station)
