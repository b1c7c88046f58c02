"""An elastic law together with the first mass moments of the links that it depends on.

Masses and centres of mass are seldom measured. A law that uses wrong ones leaves a share of itself in the residual.
The effect here has the law's own parameters and, for each of a few combinations of first moments, one more each.
"""

import numpy as np

from robot_model.effects import elastic
from workbench.core.effect import Effect
from workbench.core.errors import InputError
from workbench.core.parameters import Parameter

LAWS = {
    law.effect: law
    for law in (
        elastic.JointCompliance,
        elastic.LinkCompliance,
        elastic.BearingCompliance,
        elastic.PedestalCompliance,
    )
}
SOURCE = "first moments as in rigid-body identification: Atkeson, An & Hollerbach, Int. J. Robot. Res. 5 (1986)"


class ComplianceWithMasses(Effect):
    """A part of the machine deflects under gravity.

    First mass moments of the links are estimated jointly. `law`: name of an elastic effect with P parameters.
    `mixtures` (R, J + 1, 3) kg mm: combinations of first moments of the links and the load. `shares` (R, P): the part
    of the law itself that each combination makes; it is subtracted, so that the law's own parameters keep their
    meaning. P (1 + R) parameters.
    """

    elastic = True
    estimates_moments = True
    effect = "joint-compliance"
    port = "joint"
    places = ("joint", "link", "base")
    equation = "the law's own equation, with first moments of the links estimated"
    source = SOURCE

    def __init__(
        self, where: str, law: str, mixtures: list[list[list[float]]], shares: list[list[float]]
    ):
        super().__init__(where)
        if law not in LAWS:
            raise InputError(
                f"effect 'compliance-with-masses' at {where}, option law: expected one of {', '.join(LAWS)}, found "
                f"'{law}'; correct it"
            )
        inner = LAWS[law](where)
        self.law, self.inner, self.mixtures, self.shares = law, inner, mixtures, shares
        self.effect, self.port, self.components = inner.effect, inner.port, inner.components
        self.nonnegative, self.reads = inner.nonnegative, inner.reads
        self.subsumes, self.family = inner.subsumes, inner.family
        self.compliance_prior, self.confounded_with = inner.compliance_prior, inner.confounded_with
        self.equation = f"{inner.equation}, first moments of the links estimated"

    @classmethod
    def candidates(cls, chain):
        """None: the search makes these from the elastic laws themselves."""
        return ()

    @property
    def options(self) -> dict:
        """Its constructor's options as lists, which every file format holds."""
        return {
            "law": self.law,
            "mixtures": np.asarray(self.mixtures, float).tolist(),
            "shares": np.asarray(self.shares, float).tolist(),
        }

    def check(self, chain) -> None:
        """InputError where this chain has no such place, or other links than the mixtures."""
        self.inner.check(chain)
        bodies = np.shape(self.mixtures)[1:2]
        if bodies and bodies[0] != chain.robot.joints + 1:
            raise InputError(
                f"{self.title}, option mixtures: expected {chain.robot.joints + 1} bodies, found {bodies[0]}; "
                "use the plan of this robot"
            )

    def table(self, chain):
        """The law's own parameters, then one a combination of first moments and parameter."""
        rows = self.inner.table(chain)
        mixture_rows = [
            Parameter(
                f"{p.key}_mass_{number}",
                p.unit,
                0.0,
                p.typical,
                f"{p.label}, combination {number} of first moments",
                p.prior,
            )
            for number in range(1, len(self.mixtures) + 1)
            for p in rows
        ]
        return (*rows, *mixture_rows)

    def basis(self, state):
        """(P (1 + R), components, n)."""
        basis = self.inner.basis(state)
        blocks = [basis]
        for mixture, share in zip(self.mixtures, self.shares):
            change = self.inner.basis(state.with_moments(np.ravel(mixture))) - basis
            blocks.append(change - np.asarray(share)[:, None, None] * basis)
        return np.concatenate(blocks)


def moment_responses(law: Effect, state) -> np.ndarray:
    """(3 J + 3, P, m, n) change of a law's basis per kg mm of each first moment: of the links, then of the load."""
    nominal_basis = law.basis(state)
    return np.stack([law.basis(other) - nominal_basis for other in state.unit_moments])
