"""The candidates of a diagnosis: what the effects of a catalogue say is worth testing on a recording.

Which variants there are, with which prior, every effect says itself (`Effect.candidates`,
`Effect.grids`). Nothing here looks at a residual.
"""

from collections.abc import Iterable, Mapping

import numpy as np

from workbench.core.effect import Effect, Grid, Recorded, Variant
from workbench.core.vocabulary import Place
from workbench.diagnosis.linear.candidates import Candidate, Scan

Catalogue = Mapping[str, type[Effect]]
_JOINTED = ("joint", "link")


def variants(catalogue: Catalogue, chain: Recorded, elastic: bool = False) -> list[Variant]:
    """All candidates of a catalogue: joint by joint, and there those without gravity first; then the others.

    elastic: whether the model holds a compliance, through which alone some effects are observable.
    """
    found = []
    for kind in catalogue.values():
        if elastic or not kind.needs_compliance:
            found += kind.candidates(chain)
    return sorted(found, key=_order)


def _order(variant: Variant) -> tuple[float, bool]:
    effect = variant.effect
    if effect.places[0] in _JOINTED:
        return effect.number, bool(effect.elastic)
    return np.inf, False


def _grid_order(grid: Grid) -> tuple[float, str]:
    number = Place.of(grid.where).number
    return np.inf if number is None else number, grid.shape


def grids(catalogue: Catalogue, chain: Recorded, elastic: bool = True) -> list[Grid]:
    """All families of variants over one option, joint by joint, steps before waves; `elastic` as for `variants`."""
    found: list[Grid] = []
    for kind in catalogue.values():
        if elastic or not kind.needs_compliance:
            found += kind.grids(chain)
    return sorted(found, key=_grid_order)


def candidate_of(
    variant: Variant, columns: np.ndarray, typical: np.ndarray, load: float = 0.0
) -> Candidate:
    """A variant with the columns (N, P) and the typical sizes (P,) of its parameters; `load` as of `Candidate`."""
    effect = variant.effect
    return Candidate(
        effect.effect,
        effect.where,
        variant.label,
        (effect,),
        columns,
        typical,
        variant.family,
        variant.prior_weight,
        variant.missing_covariate,
        effect.coexists,
        effect.nonnegative,
        load,
        variant.option,
        variant.word,
        largest=effect.largest / float(typical[0]),
    )


def scan_of(grid: Grid, rows: np.ndarray, covariate: np.ndarray) -> Scan:
    """A grid with the data that it is compared with.

    rows (k, N): whitened derivatives of the residual by the effect's components; covariate (n,).
    """

    def make(value: float) -> tuple[Effect, ...]:
        return (grid.make(value),)

    kind = grid.effect
    family = Variant(grid.make(grid.values[0])).family
    is_real = grid.shape != "step" and grid.values.dtype.kind == "f"
    return Scan(
        kind.effect,
        grid.where,
        grid.shape,
        rows,
        covariate,
        grid.values.astype(float),
        grid.prior_weights,
        np.broadcast_to(np.asarray(grid.typical, float), len(rows)).copy(),
        family,
        make,
        grid.label,
        coexists=kind.coexists,
        centred=grid.centred,
        option=grid.option if is_real else "",
    )


def subsumed(catalogue: Catalogue) -> set[str]:
    """Names of the effects that are special cases of others."""
    return {name for kind in catalogue.values() for name in kind.subsumes}


def compliances(catalogue: Catalogue) -> list[type[Effect]]:
    """Effects whose signature depends on masses, without special cases of others."""
    special = subsumed(catalogue)
    return [
        kind for kind in catalogue.values() if kind.mass_dependent and kind.effect not in special
    ]


def names(kinds: Iterable[type[Effect]]) -> set[str]:
    """Words of the vocabulary of some effects."""
    return {kind.effect for kind in kinds}
