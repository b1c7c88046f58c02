"""Gears and screws by which the motion of one joint moves another."""

import numpy as np

from robot_model.effects.transmission import PLANNED_RAD, size_of, turning_joints
from workbench.core.effect import Effect, Variant
from workbench.core.errors import InputError


class JointCoupling(Effect):
    """The motion of joint J moves joint K by a fixed ratio, in addition to `coupled` in the robot file."""

    effect = "joint-coupling"
    port = "joint"
    places = ("joint",)
    equation = "dq_K = c * q_J"
    source = "wrist gear coupling, e.g. Stone, Kinematic Modeling (1987), ch. 3"
    coexists = True
    stage = "coupling"
    plant_weight = 0.2

    def __init__(self, where: str, joint: int):
        super().__init__(where)
        self.joint = joint

    @property
    def reads(self):
        return (f"q{self.joint}",)

    @classmethod
    def candidates(cls, chain):
        """From every other joint that moves."""
        moving = [k for k, q in enumerate(chain.state.drive_angles, 1) if np.ptp(q) > 0]
        for where in chain.places("joint"):
            for coupling in (cls(where, joint) for joint in moving):
                if coupling.joint != coupling.number:
                    yield Variant(coupling, f"from joint {coupling.joint}")

    @classmethod
    def planned(cls, chain):
        """Of the last three joints: a later one from an earlier one (wrist gears), a slide from any (ball screw)."""
        joints = chain.robot.joints
        last = range(max(1, joints - 2), joints + 1)
        turning = turning_joints(chain, PLANNED_RAD)
        for source in (k for k in last if f"joint-{k}" in turning):
            for moved in last:
                if moved > source or (moved < source and chain.slides(moved)):
                    yield f"joint-{moved}", {"joint": source}

    @classmethod
    def planted(cls, readings, joint, rng):
        """From a random other joint."""
        joints = range(len(readings.angles))
        other = int(rng.choice([j for j in joints if j != joint - 1]))
        angle = readings.angles[other]
        return {"joint": other + 1}, angle - angle.mean()

    def table(self, chain):
        if not 1 <= self.joint <= chain.robot.joints:
            expected = f"one of the arm's {chain.robot.joints} joints"
            raise InputError(
                f"{self.title}, option joint: expected {expected}, found {self.joint}; correct it"
            )
        unit, size = size_of(chain, self.number, 1e-3)
        other, per = size_of(chain, self.joint, 1.0)
        label = f"joint {self.number}'s share of joint {self.joint}"
        return (self.parameter(f"from{self.joint}", f"{unit}/{other}", size / per, label),)

    def basis(self, state):
        return state.drive_angles[self.joint - 1][None, None]
