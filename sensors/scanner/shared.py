"""How much points of one stripe, and stripes of one placement, err together: variances from the adjustment itself."""

from dataclasses import dataclass, replace

import numpy as np

from sensors.components import components
from sensors.light.together import NAMES, Together
from sensors.scanner.adjustment import Adjustment, linearised, solve_once, stripe_model

_MOST = 600  # stripes from which the variances are taken: they are then good to 3 %
_NEAR = 1e-2  # sigmas
_LEAST = 30.0  # degrees of freedom that tell the noise within stripes to an eighth
_ROUNDS, _AGREES = 2, 0.03  # by which a noise may differ from what it was taken for


def with_shared_errors(made: Adjustment) -> Adjustment:
    """The same adjustment, weighted by what points of stripes err alone and together."""
    for _ in range(_ROUNDS + 1):
        if made.sheets.together is None and not _turned(made):
            break
        plain = replace(made.sheets, together=None)
        made = solve_once(made.corners, plain, made.effects, made.parameters, made.free)
    together, noise = shared_errors(made)
    sheets = replace(made.sheets, together=together, sigma=made.sheets.sigma * noise)
    made = solve_once(made.corners, sheets, made.effects, made.parameters, made.free)
    for _ in range(_ROUNDS):
        scales = made.fit.scales
        if max(abs(scale - 1) for scale in scales) < _AGREES:
            break
        corners = replace(made.corners, sigma=made.corners.sigma * scales[0])
        sheets = replace(made.sheets, sigma=made.sheets.sigma * scales[1])
        made = solve_once(corners, sheets, made.effects, made.parameters, made.free)
    return made


def _turned(made):
    """Whether the mirror's numbers, whose covariance is that about the start, ended a way off it."""
    names = [f"mirror.{name}" for name in made.free]
    table = made.fit.table
    moved = {name: made.parameters[name] - table.nulls[table.index[name]] for name in names if name in table.index}
    return any(abs(move) > _NEAR * made.fit.std[name] for name, move in moved.items())


def shared_errors(made: Adjustment) -> tuple[Together, float]:
    """Sigmas of what points share, and the factor on their own noise, from residuals of an adjustment without them.

    Restricted maximum likelihood (`sensors.components`) on the adjustment's linear model, with its
    unknowns, so that what planes and poses take of a stripe's error is not counted as none. A kind that
    another one is by construction (one stripe a placement) stays 0. Where there are more than
    `_MOST` stripes, those of steps spread evenly count: the others reach them only through the
    few numbers that all share.
    """
    sheets = made.sheets
    along = (sheets.pixels[::-1] * sheets.scan).sum(0)
    together = Together.of(sheets.labels, along)
    effects = _effects(sheets, together)
    if not len(effects.kind):
        return together, 1.0
    # a placement's shift is nearly all the pose's: of what is left of it a derivative from one step before
    # would make less than nothing
    made = linearised(made)
    own, pull = _left(made, effects)
    noise = _own_noise(made, together)
    found = components(own / noise, pull / noise, effects.kind)
    more = len(NAMES) - len(found.variance)  # kinds that another one is by construction
    variance, doubt = np.append(found.variance, np.zeros(more)), np.append(found.std, np.full(more, np.inf))
    sigma = np.sqrt(variance)
    # of a square root; of one that is 0, the sigma that two sigmas of its variance would make
    with np.errstate(divide="ignore", invalid="ignore"):
        std = np.where(variance > doubt, doubt / (2 * sigma), np.sqrt(2 * doubt))
    return replace(together, sigma=sigma, std=std), float(np.sqrt(noise))


def _own_noise(made, together) -> float:
    """Factor on the points' own variance: what is left within each stripe once its shift and its tilt are off.

    Planes, poses and all shared errors are of that form along a stripe: whatever else is wrong, this is not.
    """
    sheets, stripe, place = made.sheets, together.labels[0], together.shapes[1]
    weight = np.broadcast_to(sheets.sigma, (1, sheets.n))[0] ** -2.0
    residual = made.fit.residual[1][0]

    def sums(values):
        return np.bincount(stripe, weight * values)

    total = sums(np.ones(sheets.n))
    for shape in (np.ones(sheets.n), place - (sums(place) / total)[stripe]):
        residual = residual - shape * (sums(shape * residual) / np.maximum(sums(shape**2), 1e-300))[stripe]
    degrees = float(np.maximum(np.bincount(stripe) - 2, 0).sum())
    return max(float(weight @ residual**2) / degrees, 1e-300) if degrees >= _LEAST else 1.0


@dataclass(frozen=True)
class _Effects:
    """E shared errors: `sums` (E, n) sparse, w z of each point; `kind`, `placement` (E,); `norm` (E, E) sparse, Z'W Z.
    """

    sums: object
    kind: np.ndarray
    placement: np.ndarray
    norm: object


def _effects(sheets, together) -> _Effects:
    from scipy.sparse import csr_array, vstack

    weight, n = np.broadcast_to(sheets.sigma, (1, sheets.n))[0] ** -2.0, sheets.n
    place, step = sheets.labels["placement"], sheets.labels["step"]
    parts, plain, kinds, where = [], [], [], []
    for kind, (label, shape) in enumerate(zip(together.labels, together.shapes)):
        count = int(label.max(initial=-1)) + 1
        if kind == 2 and count == together.labels[0].max(initial=-1) + 1:
            break
        chosen = np.arange(count) if kind == 2 else _some(label, step, count)
        design = csr_array((shape, (label, np.arange(n))), shape=(count, n))[chosen]
        first = np.zeros(count, int)
        first[label] = place
        plain.append(design)
        parts.append(design * weight)
        kinds.append(np.full(len(chosen), kind))
        where.append(first[chosen])
    sums, design = vstack(parts).tocsr(), vstack(plain).tocsr()
    return _Effects(sums, np.concatenate(kinds), np.concatenate(where), sums @ design.T)


def _some(label, step, count):
    """Numbers of the stripes, of evenly spread steps, that count."""
    first = np.zeros(count, int)
    first[label] = step
    steps = np.unique(first)
    kept = steps[:: -(-count // _MOST)]
    return np.flatnonzero(np.isin(first, kept))


def _left(made: Adjustment, effects: _Effects):
    """R (E, E) and g (E,) of the shared errors beside the adjustment's unknowns, with unit noise.

    Poses are eliminated as in the bundle: K the covariance of what is left under unit noise, and
    a pose's own inverse, together those of all unknowns.
    """
    fit = made.fit
    rows, pose, step = _rows(made)
    by_pose = effects.sums @ pose.T
    dense = np.hstack([effects.sums @ rows.T, (effects.sums @ step).toarray()]) if step is not None else (
        effects.sums @ rows.T)  # fmt: skip
    dense = dense - np.einsum("el,eld->ed", by_pose, fit.eliminated.mix[effects.placement])
    unit = fit.covariance / fit.sigma_scale**2
    alike = effects.placement[:, None] == effects.placement
    inner = np.einsum("el,elk->ek", by_pose, fit.eliminated.inverse[effects.placement])
    own = effects.norm.toarray() - dense @ unit @ dense.T - np.where(alike, inner @ by_pose.T, 0)
    return own, effects.sums @ fit.residual[1][0]


def _rows(made: Adjustment):
    """Derivatives (F, n) by the shared parameters, (6, n) by the pose, and sparse (n, 3 S) by the planes or None."""
    from scipy.sparse import csr_array

    model, table = stripe_model(made.sheets, made.effects, made.parameters)
    columns = [made.fit.table.index.get(key) for key in table.keys]
    free = np.array([column is not None for column in columns])
    table = table.only(free)
    evaluation = model.evaluate(table)
    rows = model.fill_rows(evaluation, table, np.empty((free.sum(), 1, made.sheets.n)))[:, 0]
    steps = 0 if made.sheets.mirror is not None else 3 * made.sheets.planes.shape[1]
    whole = np.zeros((len(made.fit.table) - steps, made.sheets.n))
    whole[[column for column in columns if column is not None]] = rows
    pose = evaluation.family_rows("placement")[:, 0]
    if not steps:
        return whole, pose, None
    n, own = made.sheets.n, evaluation.family_rows("step")[:, 0]
    place = 3 * made.sheets.labels["step"][:, None] + np.arange(3)
    by_step = csr_array((own.T.ravel(), (np.repeat(np.arange(n), 3), place.ravel())), shape=(n, steps))
    return whole, pose, by_step
