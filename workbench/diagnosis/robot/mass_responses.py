"""Elastic laws whose masses are not trusted: the data sheet only estimates the torque that deflects a joint or link.

Masses and centres of links are seldom measured. A law with the wrong ones leaves a share of itself
behind, and whatever has the shape of a torque (a harmonic, the bending of another link) is then
taken for it. So each elastic law has a second form: the same law with a few numbers more: what it
would make of first moments that the data sheet does not know.
"""

import numpy as np

from robot_model.effects.estimated_masses import (
    SOURCE,
    ComplianceWithMasses,
)
from robot_model.effects.estimated_masses import (
    moment_responses as responses,
)
from workbench.core.effect import Effect
from workbench.core.least_squares.linear_algebra import thin_svd
from workbench.core.parameters import Parameter
from workbench.diagnosis.levels import NOTABLE_SHARE

_SHARE, _CENTRE_MM = 0.2, 20.0
"""A data sheet's mass is good to a fifth, a centre to 20 mm."""
_MAX_MIXTURES = 4
"""Mixtures of first moments, each of which makes `NOTABLE_SHARE` of the law."""
LABEL = "with first mass moments estimated jointly"
MASS_SHARE, CENTRE_MM = 0.05, 5.0
"""1 sigma of a stated first moment as a share of it, and of a centre of mass (mm per axis): prior of the names."""


class MassResponse(Effect):
    """Change of a law's deflection per standard deviation of each first moment, as P M parameters.

    `inner`: a law with P parameters. Parameter after parameter, M = 3 J + 3 columns each: of every link along x, y and
    z, then of the load. It joins no model: its columns are the nuisance that a mass uncertainty makes.
    """

    elastic = True
    source = SOURCE

    def __init__(self, where: str, inner: Effect):
        super().__init__(where)
        self.inner = inner
        self.effect, self.port, self.components = inner.effect, inner.port, inner.components
        self.nonnegative, self.reads = inner.nonnegative, inner.reads
        self.places, self.equation = inner.places, inner.equation

    def table(self, chain):
        count = 3 * chain.robot.joints + 3
        return tuple(
            Parameter(
                f"{p.key}_moment_{m}",
                p.unit,
                0.0,
                p.typical,
                f"{p.label}, first moment {m}",
                p.prior,
            )
            for p in self.inner.table(chain)
            for m in range(count)
        )

    def basis(self, state):
        unit = nearly_known(state)[:, None, None, None]
        response = responses(self.inner, state) * unit
        by_parameter = response.transpose(1, 0, 2, 3)
        return by_parameter.reshape(-1, *response.shape[2:])


def with_estimated_masses(law: Effect, state) -> ComplianceWithMasses | None:
    """The law with the mixtures of first moments that move it most in these poses; None where none does."""
    law_basis = law.basis(state)
    unit = _sizes(state)[:, None, None, None]
    response = responses(law, state) * unit
    length = np.maximum((law_basis**2).sum((1, 2)), 1e-300)
    products = (response * law_basis).sum((2, 3))
    shares = products / length
    explained = shares[:, :, None, None] * law_basis
    root_length = np.sqrt(length)[:, None, None]
    remaining = (response - explained) / root_length
    flat = remaining.reshape(len(remaining), -1)
    u, s, _ = thin_svd(flat)
    relevant = np.flatnonzero(s[:_MAX_MIXTURES] > NOTABLE_SHARE)
    if not len(relevant):
        return None
    weights = u[:, relevant].T  # (R, 3 J + 3) in units of what is likely
    mixtures = (weights * _sizes(state)).reshape(len(relevant), -1, 3)
    mixed_shares = (weights @ shares).tolist()
    return ComplianceWithMasses(law.where, law.effect, mixtures.tolist(), mixed_shares)


def std_by_masses(model, fit, weights: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(P,) standard deviation that first moments off as in `nearly_known` give to each elastic law's parameters.

    0 for all others. weights (n,): of the samples; covariance (F, F) of the F free parameters over the variance of the
    noise, in typical sizes. Columns X of the free parameters and D of the moments' changes: the shift is C X'D.
    """
    parameters = fit.parameters
    laws = [(e, span) for e, span in zip(model.effects, model.spans) if e.mass_dependent]
    out = np.zeros(len(parameters))
    if not laws:
        return out
    mass_laws = (MassResponse(e.where, e) for e, _ in laws)
    wider = model.with_effects(*mass_laws)
    start = wider.parameters.take_over(parameters)
    is_moment = np.arange(len(start)) >= len(parameters)
    white = np.sqrt(weights) / model.sigma(parameters)
    derivative = wider.linearise(start.only(is_moment))[1]
    changes = (derivative * white).reshape(is_moment.sum(), -1)
    total, first = 0.0, 0
    for _, span in laws:
        values = parameters.values[span]
        all_values = sum(s.stop - s.start for _, s in laws)
        count = len(changes) * len(values) // all_values
        rows = changes[first : first + count]
        of_law = rows.reshape(len(values), -1, changes.shape[1])
        total = total + np.einsum("pmk,p->mk", of_law, values)
        first = first + count
    free = parameters.mask
    typical = parameters.typical[free]
    columns = (model.linearise(parameters)[1] * white).reshape(len(typical), -1)
    products = columns @ total.T
    shift = covariance @ (products * typical[:, None])
    spread = np.sqrt((shift**2).sum(1)) * typical
    out[free] = spread
    is_law = np.zeros(len(out), bool)
    for _, span in laws:
        is_law[span] = True
    return np.where(is_law, out, 0.0)


def nearly_known(state) -> np.ndarray:
    """(3 J + 3,) kg mm: standard deviation of each first moment where masses are stated but not measured."""
    masses, centres = _bodies(state)
    distance = np.linalg.norm(centres, axis=1)
    sigma = masses * np.hypot(MASS_SHARE * distance, CENTRE_MM)
    return np.repeat(sigma, 3)


def _sizes(state) -> np.ndarray:
    """(3 J + 3,) kg mm: by how much each first moment may be off."""
    masses, centres = _bodies(state)
    return (masses[:, None] * (_SHARE * np.abs(centres) + _CENTRE_MM)).ravel()


def _bodies(state) -> tuple[np.ndarray, np.ndarray]:
    """Masses (J + 1,) kg and centres (J + 1, 3) mm of the links and of the largest load."""
    masses = np.append(state.robot.mass, state.payload.max(initial=0.0))
    centres = np.vstack([state.robot.com, state.load_centre])
    return masses, centres
