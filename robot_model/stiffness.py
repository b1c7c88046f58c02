"""Which stiffness a calibrated model states in N m/rad, and which it knows only times a first moment."""

from dataclasses import dataclass, replace

import numpy as np

from robot_model.effects.elastic import JointCompliance
from robot_model.effects.unknown_masses import GravityCompliance
from workbench.core.least_squares.linear_algebra import pseudo_inverse
from workbench.core.model import Model

LOADS = "recorded loads"
MASSES = "stated masses"
LOADS_AND_MASSES = "recorded loads and stated masses"
PRODUCT = "product only"
_SIGNIFICANT = 2.0  # sigmas that a compliance must be above zero for a stiffness to be stated
_VARIES_KG = 1e-6
_MOST_SAMPLES = 5000  # of these the sensitivity to the centre of the load is computed


@dataclass(frozen=True)
class StiffnessRow:
    """Estimated compliance of one joint.

    `known_from`: "recorded loads", "stated masses" or both, as uncertain as these; or "product only": compliance times
    first moment, an angle. `value`, `std` in `unit` (rad/(N m) or rad); `clear`: significantly above zero.

    `stiffness` and `stiffness_std` in N m/rad, None where the compliance is not known by itself or not clear.
    `centre_per_mm`: relative change of the stiffness per mm by which the centre of the recorded load is off, in the
    worst direction; it is not part of `stiffness_std`. `load_centre_mm` (3,): this centre in the flange frame. Both
    None where no load is recorded or no stiffness stated.
    """

    where: str
    known_from: str
    value: float
    std: float | None
    unit: str
    clear: bool
    stiffness: float | None = None
    stiffness_std: float | None = None
    centre_per_mm: float | None = None
    load_centre_mm: tuple[float, ...] | None = None

    def as_json(self) -> dict:
        """The fields by name."""
        return dict(self.__dict__)


def stiffness_rows(model, parameters, std) -> list[StiffnessRow]:
    """One row per joint with a compliance in a model; std: key -> 1 sigma of the estimated parameters."""
    rows = []
    for effect, span in zip(model.effects, model.spans):
        if isinstance(effect, JointCompliance | GravityCompliance) and parameters.mask[span][0]:
            rows.append(_row(effect, model.chain, parameters, span.start, std))
    rows = [row for row in rows if row is not None]
    if not any(row.stiffness for row in rows) or not np.any(model.chain.state.payload > 0):
        return rows
    moved = _moved_by_centre(model, parameters)
    centre = np.asarray(model.chain.state.load_centre, float)
    changes = [moved.get(f"{row.where}.{JointCompliance.effect}.compliance") for row in rows]
    return [
        row if change is None or row.stiffness is None else _with_change(row, change, centre)
        for row, change in zip(rows, changes)
    ]


def _with_change(row: StiffnessRow, change: np.ndarray, centre: np.ndarray) -> StiffnessRow:
    centre_per_mm = float(np.linalg.norm(change)) / row.value
    return replace(row, centre_per_mm=centre_per_mm, load_centre_mm=tuple(centre.tolist()))


def _moved_by_centre(model, parameters) -> dict[str, np.ndarray]:
    """Free parameter -> (3,) its change per mm by which the centre of the load is off along x, y, z of the flange.

    To first order, with all free parameters and their priors fitted again.
    """
    n = model.chain.sigma.shape[1]  # samples: a length has two columns of joint readings
    part = np.arange(n)[:: max(1, -(-n // _MOST_SAMPLES))]
    chain = model.chain.at(part)
    model = Model(chain, model.effects)
    residual, rows = model.linearise(parameters)
    sigma = np.broadcast_to(model.sigma(parameters), residual.shape)
    typical = parameters.typical[parameters.mask]
    columns = (rows / sigma).reshape(len(rows), -1) * typical[:, None]
    free = [p for p, is_free in zip(parameters.table, parameters.mask) if is_free]
    prior = [0.0 if p.prior is None else (p.typical / p.prior) ** 2 for p in free]
    matrix = columns @ columns.T + np.diag(prior)
    inverse = pseudo_inverse(matrix)
    changes = []
    for axis in np.eye(3):
        state = replace(chain.state, load_centre=chain.state.load_centre + axis)
        shifted = Model(replace(chain, state=state), model.effects).residual(parameters)
        changes.append(-inverse @ (columns @ ((shifted - residual) / sigma).ravel()) * typical)
    return {p.key: change for p, change in zip(free, np.array(changes).T)}


def _row(effect, chain, parameters, first: int, std) -> StiffnessRow | None:
    key = parameters.table[first].key
    unit = parameters.table[first].unit
    value = float(parameters.values[first])
    sigma = std.get(key)
    is_clear = sigma is not None and value > _SIGNIFICANT * sigma
    if isinstance(effect, GravityCompliance):
        return StiffnessRow(effect.where, PRODUCT, value, sigma, unit, is_clear)
    if unit != "rad/(N m)":
        return None
    is_loaded = np.ptp(chain.state.payload) > _VARIES_KG
    mass = chain.robot.mass
    if mass.any():
        known_from = LOADS_AND_MASSES if is_loaded else MASSES
    else:
        known_from = LOADS
    if not mass.any() and not is_loaded and not chain.robot.payload_mass:
        known_from = PRODUCT
    if known_from == PRODUCT or not is_clear:
        return StiffnessRow(effect.where, known_from, value, sigma, unit, is_clear)
    stiffness = 1 / value, sigma / value**2
    return StiffnessRow(effect.where, known_from, value, sigma, unit, is_clear, *stiffness)


__all__ = ["LOADS", "MASSES", "PRODUCT", "StiffnessRow", "stiffness_rows"]
