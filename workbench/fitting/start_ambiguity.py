"""Whether several positions of the base fit a recording equally well, so that the start of a fit is a choice."""

import numpy as np

from robot_model.chain import forward
from robot_model.measurements import measurement_of


def ambiguity_sentence(robot, samples) -> str | None:
    """A sentence where another base fits about as well as the best; None where the best one stands alone.

    robot: the nominal arm. samples: the moving rows of a recording.
    """
    measurement = measurement_of(samples)
    if not hasattr(measurement, "system") or samples.joints.shape[1] != robot.mixing.shape[1]:
        return None
    frames = forward(robot, robot.mixing @ samples.joints.T)
    found = measurement.system(frames).alternatives()
    if len(found) == 1:
        return None
    relative = found[0].rotations[0].T @ found[1].rotations[0]
    angle = np.rad2deg(np.arccos(np.clip((np.trace(relative) - 1) / 2, -1, 1)))
    bases = f"{len(found)} poses of the base, the first two {angle:.3g} deg apart,"
    return (
        f"recording '{samples.name}': {bases} fit the nominal arm equally well, and the samples do not tell which is "
        "right; the calibration starts from the first; measure more poses, in other orientations of the flange."
    )
