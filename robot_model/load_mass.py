"""The mass of a change of load, from deflections that it makes at joints whose compliance is known by itself."""

from dataclasses import dataclass

import numpy as np

from robot_model.effects.elastic import JointCompliance
from robot_model.effects.load import LoadDeflection
from robot_model.statics import STANDARD_GRAVITY
from workbench.core.least_squares.linear_algebra import pseudo_inverse

_DETERMINED = 3.0  # sigmas from which on a compliance divides the deflection


@dataclass(frozen=True)
class LoadMass:
    """`kg` and its standard deviation, of the change of load that the parameters from `start` on describe."""

    start: int
    kg: float
    std_kg: float


def load_masses(model, values: np.ndarray, covariance: np.ndarray) -> list[LoadMass]:
    """One for each change of load of a model whose joints have a compliance in rad/(N m), as links' masses give it.

    values (P,), covariance (P, P) of all parameters. At joint K the change of weight is l_K / lambda_K; the joints are
    combined by generalised least squares, with the covariance of these ratios to first order.
    """
    compliance = {
        effect.number: span.start
        for effect, span in zip(model.effects, model.spans)
        if type(effect) is JointCompliance and not model.chain.slides(effect.number)
    }
    found = []
    for effect, span in zip(model.effects, model.spans):
        if isinstance(effect, LoadDeflection):
            pairs = [
                (span.start + k - 1, compliance_of_joint)
                for k, compliance_of_joint in compliance.items()
            ]
            combined = _combined(pairs, values, covariance)
            if combined is not None:
                found.append(LoadMass(span.start, *combined))
    return found


def _combined(pairs, values, covariance) -> tuple[float, float] | None:
    """(kg, std) from pairs of numbers of parameters, deflection and compliance; None where no compliance is known."""
    ratios = []
    rows = []
    for deflection, compliance in pairs:
        size = values[compliance]
        sigma = np.sqrt(covariance[compliance, compliance])
        if not size > _DETERMINED * sigma:
            continue
        ratio = values[deflection] / size
        row = np.zeros(len(values))
        row[deflection] = 1 / size
        row[compliance] = -ratio / size
        ratios.append(ratio)
        rows.append(row)
    if not ratios:
        return None
    ratios = np.array(ratios)
    rows = np.array(rows)
    weight = pseudo_inverse(rows @ covariance @ rows.T, 1e-12).sum(0)
    newton = float(weight @ ratios / weight.sum())
    return newton / STANDARD_GRAVITY, float(1 / np.sqrt(weight.sum()) / STANDARD_GRAVITY)


__all__ = ["LoadMass", "load_masses"]
