"""The misfit that a sound arm leaves at most."""

from workbench.fitting.plausibility.fitting import flange_scatter, reach_of

_GOOD_MM, _GOOD_REACH, _GOOD_SPREAD = 0.5, 0.001, 0.006


def good_scale(robot, recording) -> float:
    """mm of misfit that noise and the unmodelled effects of a sound arm leave at most.

    Compliance, transmission errors and drift grow with the arm and with the range over which it moves. Five real
    arms leave at most 0.05 % of their reach, and 0.4 % of the RMS distance of their flange from its mean place.
    """
    spread = flange_scatter(robot, recording)
    return max(_GOOD_MM, min(_GOOD_REACH * reach_of(robot, recording), _GOOD_SPREAD * spread))
