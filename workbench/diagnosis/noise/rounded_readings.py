"""Joint readings on a lattice, recognised from the readings of all joints: their rounding errors are known noise."""

from dataclasses import replace

import numpy as np

from robot_model.effects.friction import ReadingLattice, lattice_step
from workbench.diagnosis.levels import ANGLE_DECIMALS, NOTABLE_SHARE
from workbench.diagnosis.linear.candidates import Site
from workbench.diagnosis.linear.problem import Finding, Problem

PLACE = "samples"
"""Where the rounding errors of all joints together act."""


def rounding_site(problem: Problem) -> Site | None:
    """All joints with readings on a lattice as one place; None where there is none.

    Its typical sizes are the standard deviations of the rounding errors, step / sqrt(12) for errors uniform in a step:
    a random effect of this place has the spread 1.
    """
    found = _lattices(problem)
    if not found:
        return None
    rows = np.concatenate([site.rows for site, _, _ in found])
    steps = np.array([step for _, step, _ in found])
    typical = steps / np.sqrt(12)
    return replace(found[0][0], where=PLACE, rows=rows, typical=typical, covariates=(), pairs=())


def rounding_variance(problem: Problem) -> np.ndarray:
    """(N,) variance of each whitened coordinate by the rounding of all readings that lie on a lattice."""
    site = rounding_site(problem)
    if site is None:
        return np.zeros(len(problem.residual))
    return problem.ends.joined(((site.rows * site.typical[:, None]) ** 2).sum(0))


def rounded_readings(problem: Problem, p_value: float) -> tuple[Finding, ...]:
    """A finding for each joint whose rounding causes a relevant part of the residual, and for those with the same step.

    problem: with all effects that were found. p_value: of the rounding errors of all joints together.
    """
    residual = problem.orthogonalise(problem.residual)
    remaining = float((residual**2).sum())
    found, lattices = [], _lattices(problem)
    totals = [float((site.rows**2).sum()) * step**2 / 12 for site, step, _ in lattices]
    matter = {
        words for (*_, words), total in zip(lattices, totals) if total > NOTABLE_SHARE * remaining
    }
    for (site, _, words), squares in zip(lattices, totals):
        if words not in matter:
            continue
        variance = squares / len(problem.residual)
        size = float(np.sqrt(variance))
        description = (ReadingLattice.effect, site.where, words, ())
        found.append(Finding(*description, p_value, 1 - p_value, size, squares))
    return tuple(found)


def _lattices(problem: Problem) -> list[tuple[Site, float, str]]:
    """Joints with readings on a lattice: the place, the step in the unit of its component, and the step in words."""
    found = []
    for site in problem.sites:
        if site.port != "joint" or not site.where.startswith("joint-"):
            continue
        angle = problem.covariates.get(f"q{site.where.rpartition('-')[2]}")
        if site.unit == "mm":
            unit, factor = "mm", 1.0
        else:
            unit = "deg"
            factor = np.pi / 180
        if angle is None:
            step = None
        else:
            step = lattice_step(np.round(angle / factor, ANGLE_DECIMALS))
        if step is not None:
            found.append((site, step * factor, f"in steps of {step:.4g} {unit}"))
    return found
