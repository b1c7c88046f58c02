"""Errors that points of one stripe, and stripes of one board pose, share: variances from the adjustment itself."""

from dataclasses import dataclass, replace

import numpy as np

from sensors.light.shared_errors import NAMES, SharedStripeErrors
from sensors.scanner.adjustment import Adjustment, linearised, solve_once, stripe_model
from sensors.variance_components import estimate_components

_MAX_STRIPES = 600  # stripes from which the variances are taken: they are then good to 3 %
_CONVERGED = 1e-2  # sigmas
_MIN_DEGREES = 30.0  # degrees of freedom that tell the noise within stripes to an eighth
_ROUNDS, _AGREES = 8, 0.1  # by which part of what it is known to a variance may still change
_LIGHT = 1e3  # times their sigma, at which stripes no longer move a board that its corners hold


def with_shared_errors(adjustment: Adjustment) -> Adjustment:
    """The same adjustment, weighted by what points of stripes err alone and together.

    Boards first stand where their corners alone put them. From where stripes had pushed them, before it was known
    what these share, no line leads to the likelihood of that: the push would be read as noise of the corners.
    """
    if adjustment.board_stripes.shared_errors is None:
        adjustment = _held_by_corners(adjustment)
    for _ in range(_ROUNDS):
        before = adjustment.board_stripes.shared_errors
        errors, noise = shared_errors(adjustment)
        board_stripes = replace(
            adjustment.board_stripes,
            shared_errors=errors,
            sigma=adjustment.board_stripes.sigma * noise,
        )
        adjustment = solve_once(
            adjustment.corners,
            board_stripes,
            adjustment.effects,
            adjustment.parameters,
            adjustment.free,
        )
        if (
            _settled(before, errors)
            and abs(noise - 1) < _AGREES
            and not _has_moved_mirror(adjustment)
        ):
            break
    return adjustment


def _held_by_corners(adjustment: Adjustment) -> Adjustment:
    """Poses by the corners alone and planes by the stripes there; as a first guess of what these share, what they
    miss their planes by: the root of the mean square of the means of board poses, and of stripes relative to these."""
    board_stripes = replace(adjustment.board_stripes, sigma=adjustment.board_stripes.sigma * _LIGHT)
    with_held_corners = solve_once(
        adjustment.corners,
        board_stripes,
        adjustment.effects,
        adjustment.parameters,
        adjustment.free,
    )
    board_stripes = replace(
        with_held_corners.board_stripes, sigma=with_held_corners.board_stripes.sigma / _LIGHT
    )
    errors = SharedStripeErrors.of(board_stripes.labels, board_stripes.stripe_place)
    steps_left = with_held_corners.fit.residual[1][0]
    sigma = np.zeros(len(NAMES))
    for kind in (2, 0):
        label = errors.labels[kind]
        means = np.bincount(label, steps_left) / np.bincount(label)
        steps_left = steps_left - means[label]
        sigma[kind] = np.sqrt((means**2).mean())
    return replace(
        with_held_corners,
        board_stripes=replace(board_stripes, shared_errors=replace(errors, sigma=sigma)),
    )


def _settled(before: SharedStripeErrors, now: SharedStripeErrors) -> bool:
    """Whether variances stay, to a part of what they are known to."""
    estimated = np.isfinite(now.std)
    uncertainty = (now.std * np.maximum(now.sigma, now.std))[estimated]
    return bool((np.abs(now.sigma**2 - before.sigma**2)[estimated] <= _AGREES * uncertainty).all())


def _has_moved_mirror(adjustment):
    """Whether the mirror's numbers, whose covariance is that about the start, ended a way off it."""
    names = [f"mirror.{name}" for name in adjustment.free]
    table = adjustment.fit.table
    moved = {
        name: adjustment.parameters[name] - table.nulls[table.index[name]]
        for name in names
        if name in table.index
    }
    return any(abs(move) > _CONVERGED * adjustment.fit.std[name] for name, move in moved.items())


def shared_errors(adjustment: Adjustment) -> tuple[SharedStripeErrors, float]:
    """Sigmas of what points share, and the factor on their own noise, from an adjustment at its solution.

    Restricted maximum likelihood (`sensors.variance_components`) on the adjustment's linear model there, with its
    unknowns, so that what planes and poses take of a stripe's error is not counted as none. A kind that
    another one is by construction (one stripe a board pose) stays 0. Where there are more than
    `_MAX_STRIPES` stripes, those of steps spread evenly count: the others reach them only through the
    few numbers that all share.
    """
    board_stripes = adjustment.board_stripes
    errors = SharedStripeErrors.of(board_stripes.labels, board_stripes.stripe_place)
    effects = _effects(board_stripes, errors)
    if not len(effects.kind):
        return errors, 1.0
    noise = own_noise(
        adjustment.fit.residual[1][0],
        np.broadcast_to(board_stripes.sigma, (1, board_stripes.n))[0] ** -2.0,
        errors,
    )
    noise = noise if np.isfinite(noise) else 1.0
    gram, pull, kind = _apart_from_all(*_left(adjustment, effects), effects.kind)
    found = estimate_components(gram / noise, pull / noise, kind)
    inseparable_kinds = len(NAMES) - len(
        found.variance
    )  # kinds that another one is by construction
    variance = np.append(found.expected, np.zeros(inseparable_kinds))
    uncertainty = np.append(found.std, np.full(inseparable_kinds, np.inf))
    sigma = np.sqrt(variance)
    # of a square root; of one that is 0, the sigma that two sigmas of its variance would make
    with np.errstate(divide="ignore", invalid="ignore"):
        std = np.where(variance > uncertainty, uncertainty / (2 * sigma), np.sqrt(2 * uncertainty))
    return replace(errors, sigma=sigma, std=std), float(np.sqrt(noise))


def own_noise(residual: np.ndarray, weight: np.ndarray, errors: SharedStripeErrors) -> float:
    """Variance of residuals (n,), for unit weight, within stripes: each one's shift and tilt are off; nan for too few.

    Planes, poses and all shared errors are of that form along a stripe: whatever else is wrong, this is not.
    """
    stripe = errors.labels[0]
    place = errors.shapes[1]

    def sums(values):
        return np.bincount(stripe, weight * values)

    total = sums(np.ones(len(residual)))
    for shape in (np.ones(len(residual)), place - (sums(place) / total)[stripe]):
        residual = (
            residual - shape * (sums(shape * residual) / np.maximum(sums(shape**2), 1e-300))[stripe]
        )
    degrees = float(np.maximum(np.bincount(stripe) - 2, 0).sum())
    return (
        max(float(weight @ residual**2) / degrees, 1e-300)
        if degrees >= _MIN_DEGREES
        else float("nan")
    )


def _apart_from_all(gram, pull, kind):
    """R, g and kinds with contrasts of the board poses' shifts in place of these.

    An error that all board poses share belongs to the scanner: planes and principal point absorb nearly all of it, and
    the small remainder would take the blame for other errors.
    """
    from scipy.linalg import block_diag, helmert

    others = int((kind != 2).sum())
    shifts = int((kind == 2).sum())
    if not shifts:
        return gram, pull, kind
    change_of_basis = block_diag(np.eye(others), helmert(shifts))
    return (
        change_of_basis @ gram @ change_of_basis.T,
        change_of_basis @ pull,
        kind[: others + shifts - 1],
    )


@dataclass(frozen=True)
class _Effects:
    """E shared errors: `sums` (E, n) sparse, w z of each point; `kind`, `placement` (E,); `norm` (E, E), Z'W Z."""

    sums: object
    kind: np.ndarray
    placement: np.ndarray
    norm: object


def _effects(board_stripes, errors) -> _Effects:
    from scipy.sparse import csr_array, vstack

    weight = np.broadcast_to(board_stripes.sigma, (1, board_stripes.n))[0] ** -2.0
    n = board_stripes.n
    place = board_stripes.labels["placement"]
    step = board_stripes.labels["step"]
    designs = []
    without_cause = []
    kinds = []
    where = []
    for kind, (label, shape) in enumerate(zip(errors.labels, errors.shapes)):
        count = int(label.max(initial=-1)) + 1
        if kind == 2 and count == errors.labels[0].max(initial=-1) + 1:
            break
        chosen = np.arange(count) if kind == 2 else _chosen_stripes(label, step, count)
        design = csr_array((shape, (label, np.arange(n))), shape=(count, n))[chosen]
        first = np.zeros(count, int)
        first[label] = place
        without_cause.append(design)
        designs.append(design * weight)
        kinds.append(np.full(len(chosen), kind))
        where.append(first[chosen])
    sums = vstack(designs).tocsr()
    design = vstack(without_cause).tocsr()
    return _Effects(sums, np.concatenate(kinds), np.concatenate(where), sums @ design.T)


def _chosen_stripes(label, step, count):
    """Numbers of the stripes, of evenly spread steps, that count."""
    first = np.zeros(count, int)
    first[label] = step
    steps = np.unique(first)
    selected = steps[:: -(-count // _MAX_STRIPES)]
    return np.flatnonzero(np.isin(first, selected))


def _left(adjustment: Adjustment, effects: _Effects):
    """R (E, E) and g (E,) of the shared errors with the adjustment's unknowns projected out, unit noise.

    Poses are eliminated as in the bundle: K the covariance of what is left under unit noise, and
    a pose's own inverse, together those of all unknowns. R and g are those of points that share nothing, of the
    linear model where the adjustment stands: if that was solved for points that do, the unknowns would still move.
    """
    # of what is left of a board pose's shift, nearly all the pose's, a derivative from one step before would make less
    # than nothing
    independent = linearised(
        replace(adjustment, board_stripes=replace(adjustment.board_stripes, shared_errors=None))
    )
    fit = independent.fit
    where = effects.placement
    residual = independent.fit.residual[1][0]
    rows, pose = _rows(independent)
    by_pose = effects.sums @ pose.T
    dense = (effects.sums @ rows).toarray() - np.einsum(
        "el,eld->ed", by_pose, fit.eliminated.mix[where]
    )
    unit = fit.covariance / fit.sigma_scale**2
    inner = np.einsum("el,elk->ek", by_pose, fit.eliminated.inverse[where])
    gram = (
        effects.norm.toarray()
        - dense @ unit @ dense.T
        - np.where(where[:, None] == where, inner @ by_pose.T, 0)
    )
    moves, own_moves = fit.next
    residual = (
        residual
        + rows @ moves
        + (pose * own_moves[adjustment.board_stripes.labels["placement"]].T).sum(0)
    )
    return gram, effects.sums @ residual


def _rows(adjustment: Adjustment):
    """Derivatives, sparse (n, D) by the dense unknowns and (6, n) by the pose."""
    from scipy.sparse import csr_array, hstack

    model, table = stripe_model(adjustment.board_stripes, adjustment.effects, adjustment.parameters)
    columns = [adjustment.fit.table.index.get(key) for key in table.keys]
    free = np.array([column is not None for column in columns])
    table = table.only(free)
    evaluation = model.evaluate(table)
    rows = model.fill_rows(
        evaluation, table, np.empty((free.sum(), 1, adjustment.board_stripes.n))
    )[:, 0]
    steps = (
        0
        if adjustment.board_stripes.mirror is not None
        else 3 * adjustment.board_stripes.planes.shape[1]
    )
    full = np.zeros((len(adjustment.fit.table) - steps, adjustment.board_stripes.n))
    full[[column for column in columns if column is not None]] = rows
    pose = evaluation.family_rows("placement")[:, 0]
    n = adjustment.board_stripes.n
    if not steps:
        return csr_array(full.T), pose
    step_rows = evaluation.family_rows("step")[:, 0]
    place = 3 * adjustment.board_stripes.labels["step"][:, None] + np.arange(3)
    by_step = csr_array(
        (step_rows.T.ravel(), (np.repeat(np.arange(n), 3), place.ravel())), shape=(n, steps)
    )
    return hstack([csr_array(full.T), by_step]).tocsr(), pose
