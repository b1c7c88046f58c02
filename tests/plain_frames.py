"""An arm's frames as plain products of printed matrices: slow, and independent of the chain."""

import numpy as np
from scipy.spatial.transform import Rotation


def place(turn=None, shift=(0, 0, 0)):
    """(..., 4, 4) of one rotation or many, and shifts (..., 3) mm."""
    rotation = np.eye(3) if turn is None else turn.as_matrix()
    many = np.broadcast_shapes(rotation.shape[:-2], np.shape(shift)[:-1])
    frame = np.tile(np.eye(4), (*many, 1, 1))
    frame[..., :3, :3] = rotation
    frame[..., :3, 3] = shift
    return frame


def along_z(length):
    """(..., 4, 4) shift of `length` (...) mm along z."""
    return place(shift=np.multiply.outer(length, [0, 0, 1]))


def frames_of(robot, readings):
    """Root frame, frame after every joint, flange, at readings (J,) or (n, J): plain products of the printed matrices."""
    frames = [robot.base]
    for (theta, d, a, alpha, beta), slides, q in zip(
        robot.geometry, robot.prismatic, robot.mixing @ np.transpose(readings)
    ):
        angle = theta + (0 * q if slides else q)
        turn = place(Rotation.from_rotvec(np.multiply.outer(angle, [0, 0, 1])))
        shift = place(shift=(a, 0, 0)), along_z(d + (q if slides else 0 * q))
        twist, lean = place(Rotation.from_euler("x", alpha)), place(Rotation.from_euler("y", beta))
        distal = robot.convention == "distal"
        step = (
            turn @ shift[1] @ shift[0] @ twist @ lean
            if distal
            else lean @ twist @ shift[0] @ turn @ shift[1]
        )
        frames.append(frames[-1] @ step)
    return [*frames, frames[-1] @ robot.flange]


def middles_of(robot, frames, readings):
    """(J, 3) mm, the middle of every link: between the feet on its own axis and on the next one (or the flange)."""
    made = []
    variables = robot.mixing @ np.asarray(readings)
    for k, slides in enumerate(robot.prismatic):
        before, here = frames[k], frames[k + 1]
        foot, end = before[:3, 3], here[:3, 3]
        if robot.convention == "distal":
            foot = foot + slides * variables[k] * before[:3, 2]
        else:
            foot = end - robot.geometry[k, 1] * here[:3, 2]
        if k + 1 == robot.joints:
            end = frames[-1][:3, 3]
        elif robot.convention == "craig":
            _, _, length, _, beta = robot.geometry[k + 1]
            end = end + length * here[:3, :3] @ [np.cos(beta), 0, -np.sin(beta)]
        made.append((foot + end) / 2)
    return np.array(made)
