"""Normal equations of a bundle, group by group: samples sorted into tiles, one small Gram matrix a tile.

A tile is a run of samples of one group of every family. All tiles have one length, padded with
samples of weight 0, so that one batched product makes every Gram matrix.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from workbench.core.errors import InputError
from workbench.core.model import Model
from workbench.core.parameters import Parameter, Parameters

_A_TILE = 24  # samples that would cost as much as one more tile does


@dataclass(frozen=True)
class Family:
    """Unknowns that each of G groups of samples has of its own: `values` (G, L) to start from.

    `typical` (L,) sizes as of a Parameter; `prior` (L,) 1 sigma about the start, None: nothing known;
    `names` and `units` (L,) as the tables of kept families call them.
    """

    name: str
    values: np.ndarray
    typical: np.ndarray
    prior: np.ndarray | None = None
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()

    @property
    def length(self) -> int:
        return self.values.shape[1]

    @property
    def precision(self) -> np.ndarray:
        """(L,) 1 / prior^2, 0 where there is none."""
        return np.zeros(self.length) if self.prior is None else np.asarray(self.prior, float) ** -2

    def table(self) -> list[Parameter]:
        """One free parameter a number, keys `<family>-<group>.<name>`, groups from 0."""
        names = self.names or tuple(str(k) for k in range(self.length))
        units = self.units or ("",) * self.length
        priors = [None] * self.length if self.prior is None else [float(p) for p in self.prior]
        label = f"{{}} of {self.name} {{}}"
        return [
            Parameter(
                f"{self.name}-{group}.{name}",
                unit,
                float(start),
                float(size),
                label.format(name, group),
                p,
            )
            for group, row in enumerate(self.values)
            for name, unit, start, size, p in zip(names, units, row, self.typical, priors)
        ]


@dataclass(frozen=True)
class Tiles:
    """n samples in tiles of `length`: `index` (N,) which sample stands where, `live` (N,) False for
    padding, `place` (n,) where each sample stands, `start` first tile of each combination of groups
    and `groups` the (C,) group of each combination, by family.
    """

    index: np.ndarray
    live: np.ndarray
    place: np.ndarray
    length: int
    start: np.ndarray
    groups: Mapping[str, np.ndarray]


def tiles_of(labels: Mapping[str, np.ndarray], n: int) -> Tiles:
    """Sort n samples by their groups, labels (n,) int of each family, the first family slowest."""
    if not labels:
        labels = {"": np.zeros(n, int)}
    sizes = [int(label.max(initial=0)) + 1 for label in labels.values()]
    code = (
        np.ravel_multi_index(list(labels.values()), sizes)
        if len(labels) != 1
        else next(iter(labels.values()))
    )
    samples = np.arange(n)
    order = samples if (code[1:] >= code[:-1]).all() else np.argsort(code, kind="stable")
    ordered = code if order is samples else code[order]
    new = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]])
    counts = np.diff(new, append=n)
    codes = ordered[new]
    groups = dict(zip(labels, np.unravel_index(codes, sizes)))
    length = _tile_length(counts)
    tiles = -(-counts // length)
    start = np.cumsum(tiles) - tiles
    if order is samples and (counts == length).all():
        return Tiles(samples, np.ones(n, bool), samples, length, start, groups)
    position = samples + np.repeat(start * length - new, counts)
    index = np.repeat(order[new], tiles * length)
    live = np.zeros(tiles.sum() * length, bool)
    place = np.empty(n, int)
    index[position], live[position], place[order] = order, True, position
    return Tiles(index, live, place, length, start, groups)


def _tile_length(counts):
    """The length for which padding and the number of tiles cost least together."""
    if not len(counts):
        return 1
    lengths = np.unique(
        np.concatenate([np.quantile(counts, np.linspace(0, 1, 9), method="nearest"), [32, 64, 128]])
    )
    lengths = lengths[lengths > 0].astype(int)
    tiles = [(-(-counts // length)).sum() for length in lengths]
    return int(lengths[np.argmin([t * (length + _A_TILE) for t, length in zip(tiles, lengths)])])


@dataclass
class Blocks:
    """Normal matrix of a bundle with D dense unknowns and G groups of L that are eliminated.

    `dense` (D, D), `cross` (G, L, D), `eliminated` (G, L, L) and the gradients (D,) and (G, L).
    """

    dense: np.ndarray
    cross: np.ndarray
    eliminated: np.ndarray
    gradient: np.ndarray
    own_gradient: np.ndarray

    @classmethod
    def empty(cls, dense: int, groups: int, length: int) -> "Blocks":
        shapes = (
            (dense, dense),
            (groups, length, dense),
            (groups, length, length),
            (dense,),
            (groups, length),
        )
        return cls(*(np.zeros(shape) for shape in shapes))

    def take_off(
        self, dense: np.ndarray, block: np.ndarray, pull: np.ndarray, factor: np.ndarray
    ) -> None:
        """One product a group: rows (G, D) and (G, L), the residual's part `pull` (G,), each times `factor` (G,)."""
        weighted_dense = factor[:, None] * dense
        weighted_block = factor[:, None] * block
        self.dense -= dense.T @ weighted_dense
        self.gradient -= pull @ weighted_dense
        self.cross -= block[:, :, None] * weighted_dense[:, None]
        self.eliminated -= block[:, :, None] * weighted_block[:, None]
        self.own_gradient -= pull[:, None] * weighted_block

    def scaled(self, dense: np.ndarray, block: np.ndarray) -> "Blocks":
        """The same for unknowns in units of `dense` (D,) and `eliminated` (L,)."""
        return Blocks(
            self.dense * np.outer(dense, dense),
            self.cross * np.outer(block, dense),
            self.eliminated * np.outer(block, block),
            self.gradient * dense,
            self.own_gradient * block,
        )


@dataclass(frozen=True)
class Layout:
    """Order of the unknowns: `shared` free parameters first, then the groups of each kept family.

    `offset` of each kept family among the dense unknowns, `length` L of every family.
    """

    shared: int
    eliminate: str | None
    offset: Mapping[str, int]
    length: Mapping[str, int]


class Part:
    """One model of a bundle, its samples in tiles, and where its parameters stand in the shared table."""

    def __init__(self, model: Model, parameters: Parameters, layout: Layout):
        chain = model.chain
        labels = {
            name: np.asarray(chain.labels[name]) for name in layout.length if name in chain.labels
        }
        self.tiles = tiles_of(
            labels, chain.sigma.shape[1] if chain.sigma.shape[1] > 1 else _samples(labels, model)
        )
        self.families, self.layout = tuple(labels), layout
        is_ordered = np.array_equal(self.tiles.index, np.arange(len(self.tiles.place)))
        self.model = model if is_ordered else model.at(self.tiles.index)
        self._rows: np.ndarray | None = None
        table = self.model.parameters
        missing = [key for key in table.keys if key not in parameters.index]
        if missing:
            raise InputError(
                f"bundle: expected a parameter {missing[0]} in the shared table, found none; add it"
            )
        self.table = table
        self.places = np.array([parameters.index[key] for key in table.keys], int)
        self.columns = (np.cumsum(parameters.mask) - 1)[self.places][parameters.mask[self.places]]

    def at(
        self, parameters: Parameters, values: Mapping[str, np.ndarray]
    ) -> tuple[Model, Parameters]:
        """The model and its own table at shared parameters and family values."""
        part_parameters = replace(
            self.table, values=parameters.values[self.places], mask=parameters.mask[self.places]
        )
        chain = self.model.chain.with_families({name: values[name] for name in self.families})
        return self.model.with_chain(chain), part_parameters

    def inverse_sigma(self, parameters: Parameters) -> np.ndarray:
        """(m, N) or (m, 1) one over sigma, with the effects on the noise."""
        part_parameters = replace(self.table, values=parameters.values[self.places])
        return 1 / self.model.sigma(part_parameters)

    def residual(self, parameters: Parameters, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """(m, N) residual of the tiles, padding included."""
        model, part_parameters = self.at(parameters, values)
        return _decorrelated(model.chain, model.residual(part_parameters))

    def linearise(self, parameters, values) -> tuple[np.ndarray, np.ndarray]:
        """Residual (m, N) and rows (K + 1, m, N): free parameters, each family's, and the residual once more.

        Of a chain whose samples share errors, the rows are without those within one combination of groups
        alone: what goes across them would mix the rows of several groups, see `_less_across`.
        The rows are the same memory at every call: fresh pages would cost more than what is written there.
        """
        model, part_parameters = self.at(parameters, values)
        evaluation = model.evaluate(part_parameters)
        free = len(self.columns)
        count = free + sum(self.layout.length[name] for name in self.families)
        if self._rows is None:
            self._rows = np.empty((count + 1, *evaluation.residual.shape))
        rows = self._rows
        model.fill_rows(evaluation, part_parameters, rows[:free])
        for name in self.families:
            free, start = free + self.layout.length[name], free
            rows[start:free] = evaluation.family_rows(name)
        rows[-1] = evaluation.residual
        if hasattr(model.chain, "decorrelated"):
            rows[:] = model.chain.decorrelated(rows, between_groups=False)
        return _decorrelated(model.chain, evaluation.residual), rows

    def add_to(self, blocks: Blocks, rows: np.ndarray, root: np.ndarray) -> None:
        """Add what these samples know to the normal equations; root (m, N) 1/sigma times root of weight."""
        rows *= root
        free = len(self.columns)
        flat = rows.reshape(len(rows), -1)
        gram = flat[:free] @ flat[:free].T
        blocks.dense[np.ix_(self.columns, self.columns)] += gram
        blocks.gradient[self.columns] += flat[:free] @ flat[-1]
        if self.families:
            self._add_families(blocks, self._grams(rows, free), free)
        if (shared := getattr(self.model.chain, "between_groups", None)) is not None:
            self._subtract_shared(blocks, rows, *shared, root)

    def _subtract_shared(self, blocks, rows, shape, variance, root):
        """Take off what one error, shared by all samples of an eliminated group, leaves unknown.

        With the shape b (N,) and the variance t^2 of a group's error, the inverse of V = D + t^2 b b' is that of D
        less D^-1 b b' D^-1 t^2 / (1 + t^2 b' D^-1 b), so that of the normal equations one product a group goes off.
        """
        shape = shape * root[0]
        groups = self.tiles.groups[self.layout.eliminate]
        sums = np.add.reduceat(
            (rows[:, 0] * shape).reshape(len(rows), -1, self.tiles.length).sum(-1),
            self.tiles.start,
            axis=1,
        )
        known = np.add.reduceat((shape**2).reshape(-1, self.tiles.length).sum(-1), self.tiles.start)
        factor = variance / (1 + variance * np.bincount(groups, known, len(blocks.eliminated)))
        dense = np.zeros((len(blocks.eliminated), len(blocks.dense)))
        x = np.zeros(blocks.own_gradient.shape)
        np.add.at(dense, (groups[:, None], self.columns), sums[: len(self.columns)].T)
        first = len(self.columns)
        for name in self.families:
            family_sums = sums[first : first + self.layout.length[name]].T
            first = first + self.layout.length[name]
            if name == self.layout.eliminate:
                np.add.at(x, groups, family_sums)
            else:
                place = _Place(blocks, self.layout, name, self.tiles.groups[name])
                np.add.at(dense, (groups[:, None], place.columns(name, place.groups)), family_sums)
        blocks.take_off(dense, x, np.bincount(groups, sums[-1], len(x)), factor)

    def _grams(self, rows, free):
        """(C, families' lengths, K + 1) Gram matrix of each combination of groups."""
        shaped = rows.reshape(*rows.shape[:2], -1, self.tiles.length)
        grams = sum(
            shaped[free:-1, j].transpose(1, 0, 2) @ shaped[:, j].transpose(1, 2, 0)
            for j in range(rows.shape[1])
        )
        return self._sum_of_tiles(grams)

    def _sum_of_tiles(self, grams):
        """Gram matrices of tiles (T, ...) added up for each combination of groups."""
        start = self.tiles.start
        return grams if len(start) == len(grams) else np.add.reduceat(grams, start)

    def _add_families(self, blocks, grams, free):
        spans = {}
        start = free
        for name in self.families:
            spans[name] = slice(start, start + self.layout.length[name])
            start = spans[name].stop
        for name, span in spans.items():
            family_grams = grams[:, span.start - free : span.stop - free]
            place = _Place(blocks, self.layout, name, self.tiles.groups[name])
            place.add_shared(self.columns, family_grams[:, :, :free], family_grams[:, :, -1])
            for other, where in spans.items():
                place.add_family(other, self.tiles.groups[other], family_grams[:, :, where])


def _decorrelated(chain, rows):
    """Rows (..., n) of a chain whose samples share errors, as if they did not: see `solve_bundle`."""
    return chain.decorrelated(rows) if hasattr(chain, "decorrelated") else rows


class _Place:
    """Adds the Gram matrices of one family's groups where they belong."""

    def __init__(self, blocks, layout, name, groups):
        self.blocks, self.layout, self.name, self.groups = blocks, layout, name, groups
        self.gone = name == layout.eliminate

    def columns(self, name, groups):
        """(C, L) places among the dense unknowns."""
        length = self.layout.length[name]
        return self.layout.offset[name] + groups[:, None] * length + np.arange(length)

    def add_shared(self, columns, gram, gradient):
        if self.gone:
            _add_groups(self.blocks.own_gradient, self.groups, gradient)
            full_gram = np.zeros((*gram.shape[:2], self.blocks.cross.shape[2]))
            full_gram[:, :, columns] = gram
            _add_groups(self.blocks.cross, self.groups, full_gram)
            return
        rows = self.columns(self.name, self.groups)
        np.add.at(self.blocks.gradient, rows, gradient)
        np.add.at(self.blocks.dense, (rows[:, :, None], columns), gram)
        np.add.at(self.blocks.dense, (columns[:, None], rows[:, None, :]), gram.transpose(0, 2, 1))

    def add_family(self, other, groups, gram):
        if self.gone and other == self.name:
            _add_groups(self.blocks.eliminated, self.groups, gram)
        elif self.gone:
            rows = np.arange(gram.shape[1])[:, None]
            np.add.at(
                self.blocks.cross,
                (self.groups[:, None, None], rows, self.columns(other, groups)[:, None]),
                gram,
            )
        elif other != self.layout.eliminate:
            rows = self.columns(self.name, self.groups)
            columns = self.columns(other, groups)
            np.add.at(self.blocks.dense, (rows[:, :, None], columns[:, None]), gram)


def _add_groups(total, groups, addends):
    """Add parts (C, ...) to total (G, ...) at groups (C,), sorted."""
    new = np.flatnonzero(np.diff(groups, prepend=-1))
    total[groups[new]] += addends if len(new) == len(groups) else np.add.reduceat(addends, new)


def _samples(labels, model):
    """Number of samples of a model."""
    if labels:
        return len(next(iter(labels.values())))
    return model.residual(model.parameters).shape[1]
