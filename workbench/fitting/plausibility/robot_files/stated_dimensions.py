"""Lengths of the robot file that differ from the identified ones by more than manufacture allows."""

import numpy as np

from robot_model.chain import A, D
from workbench.core.text.uncertain import with_std
from workbench.fitting.plausibility.fitting import Fit, geometry_prior
from workbench.fitting.plausibility.linearised_fit import LinearisedFit
from workbench.fitting.plausibility.suspicion import Suspicion
from workbench.fitting.plausibility.wording import listed

CAUSE = "dimensions"
_SIGNIFICANT = 6.0  # standard deviations beyond the tolerance
_DETERMINED = 0.5  # of the prior standard deviation, up to which the data determine a length
# ISO 2768-1, class v (very coarse): nominal length up to, and permissible deviation, mm
_LENGTHS_MM = np.array([6.0, 30.0, 120.0, 400.0, 1000.0, 2000.0, 4000.0])
_TOLERANCES_MM = np.array([0.5, 1.0, 1.5, 2.5, 4.0, 6.0, 8.0, 12.0])


def dimension_suspicion(robot, recording, fit: Fit) -> Suspicion | None:
    """The stated lengths that no manufacture explains; None where there are none.

    fit: the robust fit, which estimates the geometry. What these lengths do is in the fit, so that the calibration is
    right; the file may describe another arm, or hold an error.
    """
    parameters = fit.parameters
    linear = LinearisedFit.at(robot, recording, fit)
    inverse = np.linalg.pinv(linear.matrix, rcond=1e-12, hermitian=True)
    std = linear.unit * np.sqrt(np.diag(inverse))
    prior = geometry_prior(robot, recording, parameters)[parameters.mask]
    table = [p for p, is_free in zip(parameters.table, parameters.mask) if is_free]
    found = []
    for p, value, sigma, expected in zip(table, parameters.pack(), std, prior):
        if p.unit != "mm" or not _is_length(p.key, robot) or sigma > _DETERMINED * expected:
            continue
        deviation = value - p.null
        tolerance_mm = _tolerance_mm(robot, _joint(p.key))
        if abs(deviation) > tolerance_mm + _SIGNIFICANT * sigma:
            name = p.key.partition(".")[2]
            found.append(
                f"{name} = {with_std(value, sigma)} mm instead of {p.null:g} ({deviation:+.3g} mm)"
            )
    if not found:
        return None
    are = "are" if len(found) > 1 else "is"
    sentence = (
        f"robot file of recording '{recording.name}': {listed(found)} {are} outside the tolerances of manufacture "
        "(ISO 2768-1, class v); the calibration uses the estimated lengths. Check these numbers of the robot file, and "
        "whether it describes this arm."
    )
    return Suspicion(sentence, False, CAUSE)


def _tolerance_mm(robot, joint: int) -> float:
    """Permissible deviation of a length of a joint (index): that of the longest one in its row and the rows next to it.

    An offset of zero has a tolerance, too: its axes are bored into castings of that size.
    """
    rows = robot.geometry[max(joint - 1, 0) : joint + 2, [D, A]]
    return float(_TOLERANCES_MM[np.searchsorted(_LENGTHS_MM, np.abs(rows).max())])


def _is_length(key: str, robot) -> bool:
    """Whether a parameter is a length of the arm: an a or a d, but not the zero of a slide."""
    kind = key.partition(".")[2][:1]
    if not key.startswith("joint-") or kind not in ("a", "d"):
        return False
    return kind == "a" or not robot.prismatic[_joint(key)]


def _joint(key: str) -> int:
    """Index of the joint of a parameter `joint-K. ...`."""
    return int(key.partition(".")[0].removeprefix("joint-")) - 1
