"""Offsets of base and tool that the data do not determine are held, so that unmodelled effects do not determine them.

Where all axes of an arm are parallel (SCARA, palletiser), a height of the point on the tool is as well one of the
base. Only the small tilts of the axes distinguish them: any unmodelled effect then moves both by more than a hand's
breadth along the axes, and what depends on the tilts goes with them. Such a direction is held like a gauge, and it
counts in the uncertainty of the others with a plausible size.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workbench.core.least_squares.identifiability import identifiability
from workbench.core.least_squares.single_parameters import LARGEST_SHARE
from workbench.core.least_squares.solver import Fit, normal_matrix
from workbench.core.model import Model
from workbench.core.parameters import Parameters

ROOT = {"joint-1.theta1": "base.rz", "joint-1.d1": "base.z"}
"""Parameters of where the root frame lies in the base -> parameter of the base that is confounded with each."""
_TOOL = ("tool", "sensor")


def undetermined_offsets(model: Model, fit: Fit) -> list[str]:
    """Keys of the tool's free translations that the data leave open by more than half their typical size.

    The most uncertain one first, and then those that are still undetermined with it held. fit: of all parameters.
    """
    parameters = fit.parameters
    is_offset = [
        p.prior is None and p.unit == "mm" and p.key.partition(".")[0] in _TOOL
        for p in parameters.table
    ]
    if not (parameters.mask & is_offset).any():
        return []
    normal = _normal(model, fit)
    fixed: list[str] = []
    while True:
        remaining = parameters.fix(*fixed) if fixed else parameters
        places = remaining.mask[parameters.mask]
        sigma = _sigma(normal[np.ix_(places, places)], remaining, fit.sigma_scale)
        is_open = np.array(is_offset)[remaining.mask]
        share = np.where(is_open, sigma / remaining.typical[remaining.mask], 0.0)
        if not share.max(initial=0.0) > LARGEST_SHARE:
            return fixed
        fixed.append(_free_keys(remaining)[int(share.argmax())])


def undetermined_root(model: Model, fit: Fit) -> list[str]:
    """Keys of the free parameters of `ROOT`, with a free base, that keep more than half their prior standard deviation.

    The measurements do not show the root frame: a value that they hardly determine would turn every correction in it.
    """
    parameters = fit.parameters
    keys = _free_keys(parameters)
    asked = [key for key, base in ROOT.items() if key in keys and base in keys]
    if not asked:
        return []
    sigma = dict(zip(keys, _sigma(_normal(model, fit), parameters, fit.sigma_scale)))
    prior = {p.key: p.prior for p in parameters.table}
    return [key for key in asked if prior[key] and sigma[key] > LARGEST_SHARE * prior[key]]


def with_offset_priors(parameters: Parameters, fixed: Sequence[str]) -> Parameters:
    """The parameters with their typical size as prior of the translations that are fixed.

    What depends on a fixed translation is as uncertain as a plausible error of it makes it.
    """
    table = [replace(p, prior=p.typical) if p.key in fixed else p for p in parameters.table]
    return replace(parameters, table=tuple(table))


def undetermined_offset_words(parameters: Parameters, fixed: Sequence[str]) -> str:
    """Sentence on the translations that were fixed; "" where there are none."""
    if not fixed:
        return ""
    labels = {p.key: p.label for p in parameters.table}
    # 0.0 added: a rounded -0.04 is no -0.0
    named = ", ".join(f"{labels[key]} ({round(parameters[key], 1) + 0.0:.1f} mm)" for key in fixed)
    return (
        f"These poses do not determine {named}: the same change of the base explains the measurements as well, since "
        "the axes are parallel. It is held at the value that the nominal geometry gives, which does not affect the "
        "predicted points. For the place of the root frame along the axes, measure the tool."
    )


def _normal(model: Model, fit: Fit) -> np.ndarray:
    """(F, F) whitened normal matrix of a fit; a robust fit has none of its last step."""
    if fit.gradient is None:
        return normal_matrix(model, fit.parameters)
    return fit.normal


def _sigma(normal: np.ndarray, parameters: Parameters, scale: float) -> np.ndarray:
    """(F,) standard deviations under the priors."""
    return np.sqrt(np.diag(identifiability(normal, parameters, scale).covariance))


def _free_keys(parameters: Parameters) -> list[str]:
    return [key for key, free in zip(parameters.keys, parameters.mask) if free]


__all__ = [
    "ROOT",
    "undetermined_offset_words",
    "undetermined_offsets",
    "undetermined_root",
    "with_offset_priors",
]
