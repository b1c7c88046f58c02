"""Numbers that follow from the parameters of effects: masses of loads, deflections, coefficients of linearised laws.

And their covariance where options of effects were estimated, too.
"""

from collections.abc import Sequence

import numpy as np

from robot_model.effects.curve import JointCurve, dominant_cycles, periodic_share, reading_scale
from robot_model.effects.load import LoadDeflection
from robot_model.effects.steps import Shift
from robot_model.effects.unknown_masses import TYPICAL_RAD
from robot_model.load_mass import load_masses
from workbench.core.effect import Effect
from workbench.core.least_squares.linear_algebra import least_squares
from workbench.core.model import NOISE, STATE_PORTS
from workbench.diagnosis.levels import CRITICAL_T, UNDETERMINED_STD
from workbench.diagnosis.linear.estimates import Options

DEFLECTION, MOVE = "deflection", "reflector"
_STEP = 0.01  # standard deviations of an option, half-step of a derivative
_AXES = 3  # components of a position, and the first rotation among those of a frame


def mass_rows(model, values: np.ndarray, covariance: np.ndarray) -> dict[int, dict]:
    """Start of a load's parameters -> row of its mass, as of `Bench.parameters`; values (P,), covariance (P, P)."""
    rows = {}
    for mass in load_masses(model, values, covariance):
        rows[mass.start] = {
            "key": f"tool.{LoadDeflection.effect}.mass",
            "name": "mass",
            "where": "tool",
            "label": "the mass of the change of load",
            "effect": LoadDeflection.effect,
            "value": mass.kg,
            "std": mass.std_kg,
            "unit": "kg",
            "typical": 1.0,
            "size_mm": 0.0,
            "derived": True,
        }
    return rows


def deflection_row(
    effect: Effect, values: np.ndarray, covariance: np.ndarray, chain
) -> dict | None:
    """Standard deviation over the poses of the rotation that a part makes under estimated first moments, as a row.

    values (P,), covariance C (P, P). The parameters are seldom determined one by one, the deflection is: with the
    rotations B p of the samples less their mean, its square is p' Q p, Q = B'B / n, of which noise makes tr(Q C). Its
    variance is 4 p'QCQp + 2 tr(QCQC), that of a quadratic form of normal variables (Searle, Linear Models (1971), 2.5).
    None for an effect without first moments among its parameters.
    """
    if not effect.estimates_moments:
        return None
    basis = effect.basis(chain.state)
    if effect.port == "frame":
        components = effect.components or range(2 * _AXES)
        basis = basis[:, [c >= _AXES for c in components]]
    basis = basis - basis.mean(-1, keepdims=True)
    quadratic = np.einsum("pmn,qmn->pq", basis, basis) / basis.shape[-1]
    squared = float(values @ quadratic @ values)
    if not squared > 0:
        return None
    noise = quadratic @ covariance
    variance = 4 * values @ noise @ quadratic @ values + 2 * np.einsum("pq,qp->", noise, noise)
    numbers = {
        "value": float(np.sqrt(max(squared - np.trace(noise), 0.0))),
        "std": float(np.sqrt(max(variance, 0.0) / squared) / 2),
        "unit": "rad",
        "typical": TYPICAL_RAD,
    }
    label = "deflection (standard deviation over these poses)"
    return _derived_row(effect, chain, DEFLECTION, label, numbers)


def _derived_row(effect: Effect, chain, name: str, label: str, numbers: dict) -> dict:
    """A row of `Bench.parameters` for a number that follows from the parameters of an effect."""
    first = effect.parameters(chain)[0].key
    return {
        "key": f"{first}.{name}",
        "first_parameter": first,
        "name": name,
        "where": effect.where,
        "label": label,
        "effect": effect.effect,
        "size_mm": 0.0,
        "derived": True,
        **numbers,
    }


def reflector_rows(effect: Effect, values: np.ndarray, covariance: np.ndarray, chain) -> list[dict]:
    """The step of the tool as the move of its only reflector along the axes of the flange, as rows.

    values (6,), covariance (6, 6) of the twist about the flange: a reflector at r moves by d + w x r. A single
    point determines these three numbers, and of the twist only combinations. None with several reflectors or poses.
    """
    is_point = chain.measurement.place == "tool" and len(chain.sigma) == 3
    if type(effect) is not Shift or effect.where != "tool" or not is_point:
        return []
    if len(np.unique(chain.state.index)) > 1:
        return []
    targets = np.broadcast_to(chain.state.target.T, (chain.n, 3))
    x, y, z = targets[0]
    lever = np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])
    jacobian = np.hstack([np.eye(3), lever])
    moved = jacobian @ values
    variances = np.diag(jacobian @ covariance @ jacobian.T)
    std = np.sqrt(np.maximum(variances, 0))
    rows = []
    for axis, value, error in zip("xyz", moved, std):
        label = f"move of the reflector along {axis} of the flange"
        numbers = {"value": float(value), "std": float(error), "unit": "mm", "typical": 0.1}
        row = _derived_row(effect, chain, f"{MOVE}_{axis}", label, numbers)
        rows.append(row)
    return rows


def without_shrinkage(model, fit, covariance: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """(P,) values of all parameters, those of the linear effects without the pull of their priors towards zero.

    covariance (F, F) of the F free parameters over the variance of the noise, with priors of `precision` (P,), all in
    typical sizes: an estimate and its standard deviation then have the same priors. One step of Gauss and Newton from
    the fit, where the pull of its priors balances the data. The scale of a curve's prior comes from the data and stays,
    and so do the priors of an effect that the data do not determine (`UNDETERMINED_STD`). An unknown load and the
    compliances that it deflects make a product: no single step leads to the values without their priors.
    """
    parameters = fit.parameters
    free, typical, values = parameters.mask, parameters.typical, parameters.values
    std = np.zeros(len(values))
    variances = np.maximum(np.diag(covariance), 0.0)
    std[free] = fit.sigma_scale * np.sqrt(variances)
    is_pulled = np.zeros(len(values), bool)
    has_load = any(effect.port in STATE_PORTS for effect in model.effects)
    for effect, span in zip(model.effects, model.spans):
        is_determined = (std[span] < UNDETERMINED_STD).all()
        is_product = has_load and (effect.elastic or effect.port in STATE_PORTS)
        is_linear = effect.linear and effect.port != NOISE and not is_product
        is_pulled[span] = is_linear and is_determined
    is_pulled &= free & ~model.shrunk
    variance_ratio = fit.sigma_scale**2 * fit.degrees / fit.residual.size
    trust = max(1.0, variance_ratio)
    deviation = (values - parameters.nulls) / typical
    weight_of_prior = trust * parameters.precision * typical**2
    excess = weight_of_prior - precision
    pull = np.where(is_pulled, excess * deviation, 0.0)
    step = np.zeros(len(values))
    step[free] = covariance @ pull[free]
    return np.where(is_pulled, values + step * typical, values)


def with_estimated_options(
    model, fit, weights: np.ndarray, covariance: np.ndarray, options: Options
) -> np.ndarray:
    """Covariance (P, P) of all parameters with that of the options of some effects estimated jointly with them.

    covariance: with the options known. An option is one more parameter of the linearised model: with columns X of the
    parameters and c of the options, C + C X'c (c'c - c'X C X'c)^-1 c'X C, the inverse by blocks.
    """
    options = {e: o for e, o in options.items() if e in model.effects and o.std > 0}
    if not options:
        return covariance
    scale = fit.sigma_scale**2
    white = np.sqrt(weights) / model.sigma(fit.parameters)
    mask = fit.parameters.mask
    rows = model.linearise(fit.parameters)[1]
    columns = (rows * white).reshape(mask.sum(), -1)
    slopes = np.stack(
        [_slope(model, fit, *option_of_effect) * white for option_of_effect in options.items()]
    )
    slopes = slopes.reshape(len(options), -1)
    free = np.flatnonzero(mask)
    products = columns @ slopes.T
    shared = covariance[:, free] @ products / scale
    information = slopes @ slopes.T - (columns @ slopes.T).T @ shared[free]
    inverse = np.linalg.pinv(information, hermitian=True)
    return covariance + scale * shared @ inverse @ shared.T


def _slope(model, fit, effect: Effect, option) -> np.ndarray:
    """(m, n) derivative of the residual by an option of an effect, per standard deviation of the option."""
    either = []
    for step in (_STEP, -_STEP):
        effects = tuple(option.changed(e, step) if e is effect else e for e in model.effects)
        changed = type(model)(model.chain, effects)
        either.append(changed.residual(fit.parameters))
    return (either[0] - either[1]) / (2 * _STEP)


def variation_mm(model, fit, effect: Effect, values: np.ndarray) -> float:
    """RMS displacement of the measured point by what an effect changes from pose to pose, mm; values (P,).

    The mean of a deflection under weights that are not known is not distinguishable from the geometry.
    """
    changes = effect.delta(values, model.chain.state)
    mean = changes.mean(-1, keepdims=True)
    changes = changes - mean
    rows = model.evaluate(fit.parameters).rows(
        effect.port, np.asarray(effect.port_indices(model.chain))
    )
    displacement = model.joined(np.einsum("kn,kmn->mn", changes, rows))
    moved = displacement[:_AXES]
    squares = (moved**2).sum(0)
    return float(np.sqrt(squares.mean()))


def negative_masses(bench, effects: Sequence[Effect], samples=None) -> list[Effect]:
    """Loads that cannot weigh less than nothing, of which the fitted mass is significantly negative."""
    loads = [e for e in effects if e.needs_compliance and e.nonnegative > 0]
    if not loads:
        return []
    rows = {row["key"]: row for row in bench.parameters(effects, samples)}
    masses = [(load, rows[load.parameters(bench.chain)[0].key]) for load in loads]
    return [load for load, row in masses if row["value"] < -CRITICAL_T * row["std"]]


def linear_values(
    effect: Effect, p: np.ndarray, columns: np.ndarray, state, rows, chain
) -> np.ndarray:
    """(P,) coefficients with which an effect's columns (N, P) make what it makes: its parameters where it is linear."""
    if effect.linear or effect.port in (*STATE_PORTS, NOISE):
        return p
    of_port = rows(effect.port, effect.port_indices(chain))
    delta = effect.delta(p, state)
    displacement = np.einsum("kn,kmn->mn", delta, of_port)
    contribution = rows.joined(displacement)
    return least_squares(columns, contribution.ravel())


def scale_of_reading(model, values: np.ndarray, covariance: np.ndarray, curve: JointCurve) -> dict:
    """The scale of a joint's reading where its error, of all terms of its own angle, is a straight line; else {}.

    Over less than a revolution a curve and a harmonic of low order nearly cancel, and only their sum has a meaning.
    """
    scaled_effects = [
        (effect, np.arange(span.start, span.stop))
        for effect, span in zip(model.effects, model.spans)
        if (effect.port, effect.where) == ("joint", curve.where)
        and tuple(effect.reads) == curve.reads
    ]
    laws = np.concatenate([effect.basis(model.chain.state)[:, 0] for effect, _ in scaled_effects])
    chosen = np.concatenate([numbers for _, numbers in scaled_effects])
    angle = model.chain.state.drive_angles[curve.number - 1]
    chosen_covariance = covariance[np.ix_(chosen, chosen)]
    scale = reading_scale(laws, values[chosen], chosen_covariance, angle)
    if scale is None:
        return {}
    return {"reading_scale": (scale.factor, scale.std)}


def spectrum(effect: JointCurve, coefficients: np.ndarray, chain) -> dict:
    """Size of an error curve on the visited angles, its dominant cycles and how much of it they repeat, for the row of
    its first term."""
    angle = chain.state.drive_angles[effect.number - 1]
    error = effect.curve(coefficients, angle)
    ratio = float(chain.robot.gear_ratio[effect.number - 1])
    found = dominant_cycles(effect, coefficients, gear_ratio=ratio)
    cycles = [(c.order, c.amplitude, c.per_motor_revolution) for c in found]
    share = periodic_share(effect, coefficients, found)
    curve_rms = float(error.std())
    return {"curve_rms": curve_rms, "cycles": cycles, "periodic_share": share}
