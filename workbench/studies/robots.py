"""One run of a simulated robot: its truth, its calibrations, and their errors at the test poses."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.recording import Recording
from robot_model.effects import CATALOGUE
from robot_model.effects.elastic import JointCompliance
from robot_model.state import sliding
from robot_model.system import RobotChain, bind
from workbench.core.effect import make_effects
from workbench.core.errors import InputError
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.core.solution import Stage
from workbench.files.solution_file import CalibratedArm
from workbench.fitting.calibration_plans.plans import PLAN_FILES, frames_of, geometry, plan_names
from workbench.fitting.checked_samples import check_samples
from workbench.jobs.robot.calibrate import Calibration, calibrate
from workbench.jobs.robot.compensation.compensate import compensate
from workbench.jobs.robot.simulate import Truth, truth_from
from workbench.studies.spec import Study, Tasks, validated

MODELS = ("geometry", JointCompliance.effect, "default")
"""Models that need no plan file."""
Row = dict[str, float | int | str | None]


@dataclass(frozen=True)
class World:
    """A simulated robot: `truth` at all poses; `measured`, the noisy recording to calibrate; `tests` by name.

    Each test is a recording with the true points, at which models are evaluated.
    """

    truth: Truth
    measured: Recording
    tests: dict[str, Recording]


def world(study: Study, seed: int) -> World:
    """The robot of a study's scene with these random numbers. Raises InputError."""
    from workbench.files.scene import Scene

    keys = validated(Scene, study.scene | {"seed": seed}, "study, scene")
    wanted = study.test.samples
    scene = keys.model_copy(update={"samples": keys.samples + wanted})
    truth = truth_from(scene, Path("study"))
    residual = truth.model.residual(truth.parameters)
    sigma = truth.model.sigma(truth.parameters)
    noisy = residual + truth.rng.normal(size=residual.shape) * sigma
    shown = truth.shown
    all_samples = replace(
        shown, columns=shown.columns | truth.model.chain.measurement.columns(noisy), name="study"
    )
    measured = all_samples.select(
        _designed(study, all_samples.select(np.arange(keys.samples)), truth.rng)
    )
    return World(truth, measured, dict(_tests(study, truth, np.arange(keys.samples, shown.n))))


def _designed(study: Study, candidates: Recording, rng) -> np.ndarray:
    """Rows of the candidates that are measured, in order."""
    design = study.design
    if design is None:
        return np.arange(candidates.n)
    if design.count > candidates.n:
        raise InputError(
            f"study, key design.count: expected at most {candidates.n}, the scene's samples, found {design.count}; "
            "raise scene.samples or lower it"
        )
    if design.choice in ("first", "random"):
        if design.choice == "first":
            chosen = np.arange(candidates.n)
        else:
            chosen = rng.permutation(candidates.n)
        return np.sort(chosen[: design.count])
    from workbench.jobs.robot.poses import choose_poses

    chosen = choose_poses(
        candidates, design.count, design.choice, link_radius_mm=0.0, seed=int(rng.integers(2**31))
    )
    return np.flatnonzero(np.isin(candidates.sample_ids, chosen.samples))


def _tests(study: Study, truth: Truth, rows: np.ndarray):
    """name -> recording with true points: the test poses at each load and temperature, and the tasks."""
    shown = truth.shown.select(rows)
    for payload in study.test.payload_kg or [None]:
        for temperature in study.test.temperature_c or [None]:
            changed = {"payload_kg": payload, "temperature_c": temperature}
            changed = {
                name: np.full(shown.n, value)
                for name, value in changed.items()
                if value is not None
            }
            name = "test" + _suffix(payload, "kg") + _suffix(temperature, "c")
            yield name, _true_points(truth, replace(shown, columns=shown.columns | changed))
    if study.tasks is not None:
        yield "tasks", _true_points(truth, task_rows(study.tasks, truth.shown, truth.model.chain))


def _suffix(value, unit) -> str:
    if value is None:
        return ""
    return f"_{value:g}{unit}"


def task_rows(tasks: Tasks, shown: Recording, chain: RobotChain) -> Recording:
    """The rows of a recording at the task poses. Raises InputError if they do not match the robot."""
    slides = sliding(chain.robot)
    if any(len(row) != len(slides) for row in tasks.joints_deg):
        raise InputError(
            f"study, key tasks.joints_deg: expected {len(slides)} readings a pose, as many as "
            f"{chain.robot.name} has, found another number; correct it"
        )
    n = len(tasks.joints_deg)
    columns = {name: np.full(n, values[0]) for name, values in shown.columns.items()}
    columns |= {"sample": np.arange(n, dtype=float), "time_s": np.zeros(n)}
    columns |= {
        f"q{k}_{'mm' if s else 'deg'}": np.array([row[k - 1] for row in tasks.joints_deg], float)
        for k, s in enumerate(slides, 1)
    }
    return replace(shown, columns=columns | {"payload_kg": np.full(n, float(tasks.payload_kg))})


def _true_points(truth: Truth, rows: Recording) -> Recording:
    """The same rows with the points of the true robot, without noise."""
    blank = replace(
        rows, columns=rows.columns | dict.fromkeys(("x_mm", "y_mm", "z_mm"), np.zeros(rows.n))
    )
    model = Model(
        bind(truth.model.chain.robot, blank, truth.model.chain.start), truth.model.effects
    )
    residual = model.residual(model.parameters.take_over(truth.parameters))
    columns = rows.columns | model.chain.measurement.columns(residual)
    return replace(rows, columns=columns)


def simulated(world: World, stiffer: bool = False) -> Row:
    """Errors of the uncalibrated robot (nominal geometry, true base and tool); with `stiffer` also `stiffened`."""
    row: Row = {"samples": world.measured.n}
    for name, test in world.tests.items():
        row |= _errors(f"uncalibrated_{name}", believed(world.truth, test))
    return row | (stiffened(world) if stiffer else {})


def stiffened(world: World) -> Row:
    """Errors of the uncalibrated robot with one joint twice as stiff, for each compliant joint."""
    truth, row = world.truth, {}
    name = list(world.tests)[-1]  # the tasks, or the test under the last load
    for effect in truth.model.effects:
        if (
            effect.effect != JointCompliance.effect
            or len(effect.parameters(truth.model.chain)) != 1
        ):
            continue
        key = effect.parameters(truth.model.chain)[0].key
        stiff = replace(truth, parameters=truth.parameters.update({key: truth.parameters[key] / 2}))
        points = believed(truth, _true_points(stiff, world.tests[name]))
        row[f"{effect.where}_twice_as_stiff_{name}_mm"] = _rms(points)
    return row


def believed(truth: Truth, test: Recording) -> np.ndarray:
    """(3, n) mm: prediction of the nominal robot with the true base and tool, minus the true points."""
    model = Model(bind(truth.model.chain.robot, test, truth.model.chain.start))
    return model.residual(model.parameters)[:3]


def _rms(residual: np.ndarray) -> float:
    return float(np.sqrt((residual**2).sum(0).mean()))


def _errors(name: str, residual: np.ndarray) -> Row:
    distance = np.sqrt((residual**2).sum(0))
    return {f"{name}_mm": _rms(residual), f"{name}_max_mm": float(distance.max())}


def plan_of(name: str, recording: Recording) -> Path | tuple[Stage, ...] | None:
    """The plan argument of `calibrate` for the name of a model."""
    if name == "default":
        return None
    if name not in MODELS:
        return Path(name)
    from robot_model import load_robot

    robot = load_robot(recording.robot, "robot of the study")
    stages = (geometry(robot),)
    if name == JointCompliance.effect:
        planned = JointCompliance.planned(bind(robot, recording))
        torsion = tuple((name, where, options) for where, options in planned)
        stages += (
            Stage(
                "compliance",
                "joints deflect under the weight of links and load",
                torsion,
                earn=False,
            ),
        )
    return stages


def check_models(study: Study, folder: Path) -> Study:
    """The study with absolute paths of its plan files. Raises InputError for an unknown model."""
    from workbench.fitting.calibration_plans.plans import read_plan

    named = []
    for name in study.models:
        if name not in MODELS and name not in plan_names():
            read_plan(folder / name)
            name = str((folder / name).resolve())
        elif name not in MODELS:
            make_effects(
                CATALOGUE,
                [row for stage in read_plan(PLAN_FILES / f"{name}.toml") for row in stage.effects],
            )
        named.append(name)
    return study.model_copy(update={"models": named})


def calibrations(study: Study, measured: Recording) -> dict[str, Calibration]:
    """Calibrations of one recording, by model. Its samples are checked once."""
    checked = check_samples(measured)
    return {
        Path(name).stem: calibrate(checked, plan_of(name, measured), folds=study.folds)
        for name in study.models
    }


def errors_row(calibrations: dict[str, Calibration], tests: dict[str, Recording]) -> Row:
    """Held-out errors, and errors at the tests, of the nominal robot and of each model."""
    first = next(iter(calibrations.values()))
    row: Row = {"nominal_held_out_mm": first.nominal["rms_mm"]}
    frames = _with_frames(first.robot, first.recording) if tests else None
    for name, test in tests.items():
        row |= _errors(f"nominal_{name}", nominal_residual(first, test, frames))
    for name, calibration in calibrations.items():
        row |= {
            f"{name}_fit_mm": calibration.fit["rms_mm"],
            f"{name}_held_out_mm": calibration.held_out["rms_mm"],
            f"{name}_identifiable": calibration.solution.known.rank,
            f"{name}_converged": int(calibration.solution.converged),
        }
        for test, rows in tests.items():
            row |= _errors(f"{name}_{test}", residual_of(calibration, rows))
    return row


def residual_of(calibration: Calibration, test: Recording) -> np.ndarray:
    """(3, n) mm: prediction of a calibrated robot minus the points of `test`."""
    chain = bind(calibration.robot, test, calibration.model.chain.start)
    model = Model(chain, calibration.model.effects)
    return model.residual(model.parameters.take_over(calibration.solution.parameters))[:3]


def nominal_residual(
    calibration: Calibration, test: Recording, frames: Parameters | None = None
) -> np.ndarray:
    """(3, n) mm: residual of the nominal geometry, with base and tool fitted to the calibration samples.

    frames: this fit, where it was made before.
    """
    fitted = frames or _with_frames(calibration.robot, calibration.recording)
    model = Model(bind(calibration.robot, test, calibration.model.chain.start))
    return model.residual(model.parameters.take_over(fitted))[:3]


def _with_frames(robot, recording: Recording) -> Parameters:
    model = Model(bind(robot, recording))
    return solve(model, model.parameters.free(*frames_of(model.parameters))).parameters


def compensated(calibrations: dict[str, Calibration], world: World) -> Row:
    """Errors of the real arm relative to the programmed nominal arm, before and after compensation with each model.

    The points are compared after a fit of base and tool at the nominal geometry, as taught frames would absorb them.
    `…_reached` is the share of poses that could be corrected.
    """
    name, programmed = next(iter(world.tests.items()))
    row: Row = {"programmed_mm": _as_nominal(world.truth, programmed, programmed.joints)}
    covariates = {k: v for k, v in programmed.covariates.items() if k != "range_mm"}
    for called, calibration in calibrations.items():
        found = compensate(arm_of(calibration), programmed.joints, covariates=covariates)
        reached_rows = np.flatnonzero(
            found.reached
        )  # near a singularity no small correction changes the orientation
        if reached_rows.size:
            row[f"{called}_compensated_mm"] = _as_nominal(
                world.truth, programmed.select(reached_rows), found.readings[reached_rows]
            )
        row[f"{called}_reached"] = float(found.reached.mean())
    return row


def _as_nominal(truth: Truth, programmed: Recording, readings: np.ndarray) -> float:
    """RMS, mm, between the true points at `readings` and a nominal arm at the programmed readings."""
    robot = truth.model.chain.robot
    driven = {}
    for k, (values, s) in enumerate(zip(readings.T, sliding(robot)), 1):
        if s:
            driven[f"q{k}_{'mm' if s else 'deg'}"] = values
        else:
            driven[f"q{k}_{'mm' if s else 'deg'}"] = np.rad2deg(values)
    rows = replace(programmed, columns=programmed.columns | driven)
    points = _true_points(truth, rows)
    names = ("x_mm", "y_mm", "z_mm")
    seen = replace(
        programmed, columns=programmed.columns | {k: points.columns[k] for k in names}, sigma_mm=1.0
    )
    model = Model(bind(robot, seen))
    return _rms(solve(model, model.parameters.free(*frames_of(model.parameters))).residual[:3])


def arm_of(calibration: Calibration) -> CalibratedArm:
    """The calibrated arm as input of `compensate`."""
    solution, chain = calibration.solution, calibration.model.chain
    parameters = solution.parameters
    free = tuple(key for key, is_free in zip(parameters.keys, parameters.mask) if is_free)
    return CalibratedArm(
        calibration.robot,
        calibration.model.effects,
        dict(zip(parameters.keys, parameters.values.tolist())),
        free,
        solution.covariance,
        np.asarray(chain.state.load_centre),
        calibration.held_out["rms_mm"],
        True,
        "",
        {},
    )


def parameter_row(calibrations: dict[str, Calibration], same_arm: bool = False) -> Row:
    """Value and sigma of every free parameter of each model; None if it is not identifiable.

    same_arm: True where all runs measure the same arm. Parameters that are held because others carry them are then
    the same in all runs, so that sigma leaves out what they could be; otherwise it is the stated one.
    """
    row: Row = {}
    for name, calibration in calibrations.items():
        for parameter in calibration.parameters:
            if parameter["free"]:
                key = f"{name}:{parameter['where']}.{parameter['name']}"
                row |= {
                    key: parameter["value"],
                    f"{key}:std": _sigma(parameter, calibration, same_arm),
                }
    return row


def _sigma(parameter: dict, calibration: Calibration, same_arm: bool) -> float | None:
    if parameter["std"] is None or not same_arm:
        return parameter["std"]
    return calibration.solution.std[f"{parameter['where']}.{parameter['name']}"]


def diagnosed(study: Study, measured: Recording) -> Row:
    """The verdict of `workbench.diagnosis`, and the effects that it names."""
    from workbench.explanation.answer import diagnose

    found = diagnose(measured).as_json()
    effects = [f"{effect['effect']}@{effect['where']}" for effect in found["effects"]]
    true = [
        f"{effect['effect']}@{effect['where']}" for effect in (study.scene or {}).get("effect", [])
    ]
    row: Row = {"verdict": found["verdict"], "found": " ".join(effects)}
    if true:
        row |= {
            "found_true": len(set(true) & set(effects)),
            "found_false": len(set(effects) - set(true)),
        }
    held_out = found.get("held_out") or {}
    return row | {
        f"diagnosis_{name}": held_out.get(name) for name in ("before_mm", "after_mm", "noise_mm")
    }
