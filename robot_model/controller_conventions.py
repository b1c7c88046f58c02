"""Joint conventions of the controllers of three makers for six-axis arms: zero posture and positive senses.

In the root frame, x forward, y to the left, z up, with all joints at zero:

| maker | upper arm | axes 1 to 6, in the sense of growing readings |
|---|---|---|
| ABB | up | z, y, y, x, y, x |
| FANUC | up | z, y, -y, -x, -y, -x |
| KUKA | forward | -z, y, y, -x, y, -x |

The forearm points forward. Robot files may count otherwise (other zeros, the table of a paper, a simulation).
"""

import numpy as np

from robot_model.chain import forward
from robot_model.robot import Robot

_X, _Y, _Z = np.eye(3)
AXES = {
    "ABB": np.stack([_Z, _Y, _Y, _X, _Y, _X]),
    "FANUC": np.stack([_Z, _Y, -_Y, -_X, -_Y, -_X]),
    "KUKA": np.stack([-_Z, _Y, _Y, -_X, _Y, -_X]),
}
_UPPER_ARM = {"ABB": _Z, "FANUC": _Z, "KUKA": _X}
_ALIGNED = 0.99
_MIN_COSINE = 0.7  # of forearms with an offset between elbow and axis 4


def parts_like_controller(robot: Robot, maker: str) -> tuple[bool, bool]:
    """Whether zeros and senses of the readings are those of the controller of a maker (key of `AXES`), for the arm
    (joints 1 to 3) and for the wrist (joints 4 to 6).

    A wrist is compared at zero readings of the arm, so that it agrees with the controller only where the arm does.
    """
    variables = robot.mixing @ np.zeros((robot.mixing.shape[1], 1))
    frames = forward(robot, variables)
    growing = frames.z[:, :, 0] * np.sign(np.diag(robot.mixing))[:, None]
    is_same = (growing * AXES[maker]).sum(1) > _ALIGNED
    points = frames.z_origin[:, :, 0]
    upper = points[2] - points[1]
    forearm = points[4] - points[2]
    is_straight = upper @ _UPPER_ARM[maker] > _ALIGNED * np.linalg.norm(upper)
    is_ahead = forearm @ _X > _MIN_COSINE * np.linalg.norm(forearm)
    return bool(is_same[:3].all() and is_straight and is_ahead), bool(is_same[3:].all())
