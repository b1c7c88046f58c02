"""Joint readings on a lattice: recognised from the readings, and stated where rounding makes a part of what is left."""

import numpy as np

from robot_model.effects.friction import ReadingLattice, lattice_step
from workbench.diagnosis.linear.problem import Finding, Problem
from workbench.diagnosis.noise.random_effects import residual_random_effect

_LEAST_SHARE, _MOST_SHARE = 0.03, 1.5
"""Share of what is left that rounding makes: less does not matter, more contradicts the lattice."""
_DECIMALS = 6
"""Of a degree or mm: what conversions between units leave of a lattice."""


def rounded_readings(problem: Problem, level: float) -> tuple[Finding, ...]:
    """A finding for each joint whose readings lie on a lattice that makes a part of what is left.

    problem: with all effects that were found. level: of the test that the joint moves from sample to sample. The
    variance that rounding makes is that of an error uniform in one step: step^2 / 12.
    """
    left = float((problem.orthogonalise(problem.residual) ** 2).sum())
    found = []
    for site in problem.sites:
        made = _lattice(problem, site)
        if made is None:
            continue
        step, words = made
        squares = float((site.rows**2).sum()) * step**2 / 12
        if not _LEAST_SHARE < squares / max(left, 1e-300) < _MOST_SHARE:
            continue
        moves = residual_random_effect(problem, site.where, site.port, level)
        if moves is not None:
            size = float(np.sqrt(squares / len(problem.residual)))
            p = moves.p_value
            found.append(
                Finding(ReadingLattice.effect, site.where, words, (), p, 1 - p, size, squares)
            )
    return tuple(found)


def _lattice(problem: Problem, site) -> tuple[float, str] | None:
    """Step of the readings of a joint in the unit of its slot, and in words; None where they show none."""
    number = site.where.rpartition("-")[2]
    angle = problem.covariates.get(f"q{number}")
    if site.port != "joint" or not site.where.startswith("joint-") or site.sharp or angle is None:
        return None
    unit, factor = ("mm", 1.0) if site.unit == "mm" else ("deg", np.pi / 180)
    step = lattice_step(np.round(angle / factor, _DECIMALS))
    return None if step is None else (step * factor, f"in steps of {step:.4g} {unit}")


__all__ = ["rounded_readings"]
