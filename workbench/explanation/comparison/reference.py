"""A recording against a simulation or an earlier calibration: the three kinds of difference, separated.

What a simulation and a recording differ by is, first, parameter values that are merely not those of this machine
(where base and tool stand, lengths, offsets, the sizes of effects that the simulation already holds); second, noise;
third, structure that no value of those parameters makes. Only the third is missing physics.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from robot_model import load_robot
from robot_model.effects import CATALOGUE
from robot_model.files.mjcf import is_mjcf, terms_of, unread
from robot_model.files.urdf import tree_of
from robot_model.measurements import samples_of
from robot_model.system import bind, geometry_free
from workbench.core.effect import make_effects
from workbench.core.errors import InputError
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.robot_files.robot_description import file_and_tip, is_description
from workbench.explanation.comparison.uncertain_reference import ValueUncertainty
from workbench.files.solution_file import read_solution
from workbench.fitting.calibration_plans.plans import frames_of
from workbench.fitting.cross_validation import in_space
from workbench.jobs.robot.simulate import truth_of

_LENGTH_MM = 1.0


@dataclass(frozen=True)
class Reference:
    """Reference model of a comparison: a robot, the effects that it holds, and their values by key.

    `robot_keys`: what `load_robot` makes the robot of. `sigma_mm`: the noise that the reference states. `notes`:
    sentences for what its file says and the comparison does not use. `group_names`: of the reflectors that it knows by
    numbers. `uncertainty`: of the values that an earlier calibration estimated; None for a simulation.
    """

    name: str
    robot: object
    effects: tuple
    values: dict[str, float]
    robot_keys: dict
    sigma_mm: float | None = None
    notes: tuple[str, ...] = ()
    group_names: Mapping[str, Sequence[str]] = field(default_factory=dict)
    uncertainty: ValueUncertainty | None = None


@dataclass(frozen=True)
class Shares:
    """Mean squared 3-D distance between prediction and measurement, mm^2, in three parts that add up.

    `parameters_mm2`: falls when the values of the reference are estimated again; `placing_mm2` of it when base and
    tool alone are. `noise_mm2`: what the instrument leaves. `structure_mm2`: the rest, which no value makes.
    `moved` (sorted) the fall that each group of parameters owes, one group after another.
    """

    reference: str
    total_mm2: float
    parameters_mm2: float
    placing_mm2: float
    noise_mm2: float
    structure_mm2: float
    moved: tuple[dict, ...]

    def as_json(self) -> dict:
        """Keys with their unit; the three shares add up to the total."""
        return {
            "reference": self.reference,
            "total_mm2": self.total_mm2,
            "parameters_mm2": self.parameters_mm2,
            "placing_mm2": self.placing_mm2,
            "noise_mm2": self.noise_mm2,
            "structure_mm2": self.structure_mm2,
            "moved": list(self.moved),
        }


def reference_of(
    simulation: Path | None, solution: Path | None, robot: object = None
) -> Reference | None:
    """The scene or the solution that was named; None where neither was. InputError for both, or an unreadable one.

    robot: that of the recording, as in its file; `tip` and `joints` that it names count for a URDF or MJCF file, too.
    """
    if simulation is not None and solution is not None:
        raise InputError(
            "--simulation and --solution: expected one of them, found both; leave out the one that the recording is "
            "not to be compared with."
        )
    if simulation is not None and is_description(simulation):
        return _from_description(simulation, robot if isinstance(robot, Mapping) else {})
    if simulation is not None:
        truth = truth_of(Path(simulation))
        robot = truth.model.chain.robot
        parameters = truth.parameters
        values = dict(zip(parameters.keys, parameters.values.tolist()))
        keys = dict(truth.shown.robot)
        sigma = truth.shown.sigma_mm
        return Reference(
            f"simulation {simulation}", robot, truth.model.effects, values, keys, sigma
        )
    if solution is None:
        return None
    arm = read_solution(Path(solution))
    keys = dict(arm.keys["robot"])
    names = arm.keys.get("group_names", {})
    return Reference(
        f"solution {solution}",
        arm.robot,
        arm.effects,
        arm.values,
        keys,
        group_names=names,
        uncertainty=ValueUncertainty(arm.free, arm.covariance),
    )


def _from_description(simulation: Path, named: Mapping) -> Reference:
    """A URDF or MJCF file (FILE or FILE#LINK): its nominal arm, and the terms of an exported one.

    named: `tip` and `joints` that count where the file has such links and joints.
    """
    path, tip = file_and_tip(simulation)
    keys = {"urdf": str(path.resolve())}
    tree = tree_of(keys, str(path))
    if tip is not None or named.get("tip") in tree.links:
        keys["tip"] = tip or named["tip"]
    if named.get("joints") and set(named["joints"]) <= set(tree.joints):
        keys["joints"] = list(named["joints"])
    robot = load_robot(keys, str(path))
    mjcf_keys = {}
    notes = ()
    if is_mjcf(path):
        mjcf_keys = terms_of(path)
        notes = () if mjcf_keys else tuple(unread(path))
    if not robot.mass.any():
        notes = (
            *notes,
            f"{path.name} states no masses: deflection under gravity is found only as compliance times first moment.",
        )
    if robot.joint_names and not _are_numbered(robot.joint_names):
        called = ", ".join(f"{k} {name}" for k, name in enumerate(robot.joint_names, 1))
        notes = (*notes, f"Joints are numbered along the chain of {path.name}: {called}.")
    rows = [(row.pop("effect"), row.pop("where"), row) for row in mjcf_keys.get("effects", [])]
    effects = make_effects(CATALOGUE, rows)
    return Reference(
        f"simulation {path}", robot, effects, mjcf_keys.get("values", {}), keys, None, notes
    )


def _are_numbered(names: Sequence[str]) -> bool:
    """Whether the only number in each name is that of the joint in the chain: joint_1, joint_2, ..."""
    return all(re.findall(r"\d+", name) == [str(k)] for k, name in enumerate(names, 1))


def bound(reference: Reference, recording) -> tuple[Model, Parameters]:
    """The reference's model on the moving rows of a recording, with its values; InputError where the arms differ.

    Where the recording has reflectors or balls that the reference does not place, those start in closed form.
    """
    moving = samples_of(recording)
    readings = reference.robot.mixing.shape[1]
    if moving.joints.shape[1] != readings:
        raise InputError(
            f"recording '{recording.name}' against {reference.name}: expected {readings} joint readings a sample as "
            f"{reference.robot.name} has, found {moving.joints.shape[1]}; name a simulation or solution of this arm."
        )
    model = Model(bind(reference.robot, moving), reference.effects)
    known = {key: value for key, value in reference.values.items() if key in model.parameters.index}
    return model, model.parameters.update(known)


def shares(
    model: Model,
    parameters: Parameters,
    noise_mm: Callable[[np.ndarray, float], float],
    name: str = "",
) -> Shares:
    """Split what the model at `parameters` leaves of its recording into its three parts.

    noise_mm: from the residual (3, n) mm of the best values, and the degrees of freedom left of its 3 n, the noise
    as the RMS of a 3-D distance, mm. A fit absorbs the noise of as many coordinates as it has parameters; that part
    is booked as noise, too, so that it is not taken for parameters that were wrong.
    """
    total = _square(model, parameters)
    placed = solve(model, _free(parameters, frames_of(parameters)))
    all_free = _free(
        placed.parameters, (*frames_of(parameters), *geometry_free(model.chain.robot)), model
    )
    fitted = solve(model, all_free)
    residual = in_space(fitted.residual)
    residual_variance = float((residual**2).sum(0).mean())
    free = fitted.residual.size - fitted.degrees
    noise = noise_mm(residual, fitted.degrees) ** 2
    absorbed = min(noise * free / fitted.residual.size, max(total - residual_variance, 0.0))
    noise = min(noise - absorbed, residual_variance) + absorbed
    placing = max(total - float((in_space(placed.residual) ** 2).sum(0).mean()), 0.0)
    return Shares(
        name,
        total,
        total - residual_variance - absorbed,
        placing,
        noise,
        residual_variance + absorbed - noise,
        _moved(parameters, fitted.parameters),
    )


def _square(model, parameters) -> float:
    return float((in_space(model.residual(parameters)) ** 2).sum(0).mean())


def _free(parameters: Parameters, patterns, model: Model | None = None) -> Parameters:
    """Those of the patterns free, and of a model also what its effects bring."""
    mask = parameters.matching(*patterns)
    if model is not None:
        chain_size = len(model.chain.parameters)
        mask = mask | (np.arange(len(mask)) >= chain_size)
    return parameters.only(mask)


def _moved(before: Parameters, after: Parameters) -> tuple[dict, ...]:
    """The values of the reference that moved most, in typical sizes, base and tool left out."""
    frames = before.matching(*frames_of(before))
    change = np.where(frames | ~after.mask, 0.0, (after.values - before.values) / after.typical)
    order = [int(k) for k in np.argsort(-np.abs(change), kind="stable")[:8] if change[k]]
    return tuple(
        {
            "name": after.keys[k],
            "before": float(before.values[k]),
            "after": float(after.values[k]),
            "unit": after.table[k].unit,
        }
        for k in order
    )
