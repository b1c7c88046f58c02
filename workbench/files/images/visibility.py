"""Visibility of a ball from a sensor on the arm: distances, angles of view, and occlusion."""

from dataclasses import dataclass, replace

import numpy as np

from robot_model.postures.clearance import hidden_by_others, view_clearance
from robot_model.robot import Robot
from robot_model.system import bind
from workbench.core.errors import InputError
from workbench.core.rigid import rotation_matrix

TOO_FAR, OUTSIDE_FIELD, BEHIND_HORIZON, HIDDEN = (
    "out of the stand-off",
    "outside the field",
    "below the ball's cap",
    "ball hidden",
)


@dataclass(frozen=True)
class Sight:
    """`stand_off_mm` (nearest, farthest) distance of a ball's centre from the sensor's origin; `field_deg` by which it
    may lie off the sensor's z axis; `cap_deg` by which the line of sight may lean off the vertical: a ball that
    stands on a stem shows its upper cap. None: not asked for.
    """

    stand_off_mm: tuple[float, float] | None = None
    field_deg: float | None = None
    cap_deg: float | None = None

    def checked(self, measures: str) -> "Sight":
        """Itself; InputError where a number cannot be, or where nothing is looked at."""
        if self.stand_off_mm is not None and not 0 <= self.stand_off_mm[0] < self.stand_off_mm[1]:
            raise InputError(
                f"--stand-off {self.stand_off_mm[0]:g} {self.stand_off_mm[1]:g}: expected the nearest and "
                "the farthest distance in mm, found none in between; correct them"
            )
        for option, value, upper in (("--field", self.field_deg, 90), ("--cap", self.cap_deg, 180)):
            if value is not None and not 0 < value <= upper:
                raise InputError(
                    f"{option} {value:g}: expected an angle above 0 and up to {upper} deg; correct it"
                )
        if measures != "ball-centre" and self != EVERYTHING:
            raise InputError(
                f"--stand-off, --field, --cap: expected candidates that measure ball-centre, where a "
                f"sensor looks at balls, found {measures}; leave them out"
            )
        return self


EVERYTHING = Sight()


def unseen(robot: Robot, recording, link_radius: float, sight: Sight) -> dict[str, np.ndarray]:
    """Reason -> (n,) True where a row's ball cannot be seen for it; empty for kinds where nothing is looked at.

    recording: its moving rows; link_radius: half the thickness of the arm's links, mm, 0 for no such check.
    """
    if recording.measures != "ball-centre":
        return {}
    sight_line, hidden = _lines(robot, recording, link_radius)
    seen = recording.points.T
    off_axis = np.arctan2(np.hypot(seen[0], seen[1]), seen[2])
    leaning = np.arccos(
        np.clip(-robot.gravity @ sight_line / np.linalg.norm(sight_line, axis=0), -1, 1)
    )
    near_limit, far_limit = sight.stand_off_mm or (0.0, np.inf)
    distance = np.linalg.norm(seen, axis=0)
    return {
        TOO_FAR: (distance < near_limit) | (distance > far_limit),
        OUTSIDE_FIELD: off_axis > np.deg2rad(180 if sight.field_deg is None else sight.field_deg),
        BEHIND_HORIZON: leaning > np.deg2rad(180 if sight.cap_deg is None else sight.cap_deg),
        HIDDEN: hidden,
    }


def _lines(robot, recording, link_radius):
    """From ball to sensor (3, n) mm, root frame, and (n,) whether another ball or a link is in between."""
    chain = bind(
        robot, recording if recording.sigma is not None else replace(recording, sigma_mm=1.0)
    )
    values = chain.parameters.values
    frames, _ = chain.frames(values, {})
    base, _, hand = chain.split(values)
    eye = frames.point(hand[:3])
    target = chain.measurement.targets(hand)
    balls = np.array([recording.balls[i] for i in chain.measurement.ids])
    hidden = hidden_by_others(eye, target, balls[:, :3], balls[:, 3], chain.measurement.index)
    into_root = rotation_matrix(base[3:]).T
    eye, target = (into_root @ (points - base[:3, None]) for points in (eye, target))
    if link_radius > 0:
        hidden |= (
            view_clearance(robot, robot.mixing @ recording.joints.T, eye, target, link_radius)
            < link_radius
        )
    return eye - target, hidden
