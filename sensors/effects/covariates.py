"""What the effects of heat on a scanner share: where a diagnosis tests them."""

from workbench.core.effect import Variant
from workbench.core.vocabulary import Covariate

CLOCKS = ("temperature_c", "time_s")


def warming(kind, chain):
    """The effect `kind` at its places, where temperature or else time varies; with what it has to do without."""
    if any(chain.varies(name) for name in CLOCKS):
        known = any(Covariate.of(name).kind == "temperature" for name in chain.varying)
        for place in kind.places:
            for where in chain.places(place):
                yield Variant(kind(where), missing="" if known else "temperature")
