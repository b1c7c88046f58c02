"""An arm's frames as plain products of printed matrices: slow, and independent of the chain."""

import numpy as np
from scipy.spatial.transform import Rotation


def place(turn=None, shift=(0, 0, 0)):
    frame = np.eye(4)
    frame[:3, :3] = np.eye(3) if turn is None else turn.as_matrix()
    frame[:3, 3] = shift
    return frame


def frames_of(robot, readings):
    """Root frame, frame after every joint, flange: plain products of the printed matrices."""
    frames = [robot.base]
    for (theta, d, a, alpha, beta), slides, q in zip(
        robot.geometry, robot.prismatic, robot.mixing @ readings
    ):
        turn = place(Rotation.from_euler("z", theta + (0 if slides else q)))
        shift = place(shift=(a, 0, 0)), place(shift=(0, 0, d + (q if slides else 0)))
        twist, lean = place(Rotation.from_euler("x", alpha)), place(Rotation.from_euler("y", beta))
        distal = robot.convention == "distal"
        step = (
            turn @ shift[1] @ shift[0] @ twist @ lean
            if distal
            else lean @ twist @ shift[0] @ turn @ shift[1]
        )
        frames.append(frames[-1] @ step)
    return [*frames, frames[-1] @ robot.flange]
