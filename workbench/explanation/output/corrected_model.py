"""The corrected model of a diagnosis in runnable form: a plan, a solution and a scene.

The plan holds the geometry, the effects of the baseline and one stage a term that was kept. The recording is
calibrated by it, so that the solution has a covariance and held-out errors like that of every calibration. Terms that
were found and refused are not in the model; the solution states what they add to its uncertainty.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from robot_model import load_robot
from robot_model.effects import CATALOGUE
from workbench.core.errors import InputError
from workbench.core.solution import Stage
from workbench.explanation.output.considered_terms import considered_terms
from workbench.explanation.result import Diagnosis
from workbench.files.solution_file import NAME as SOLUTION
from workbench.files.solution_file import robot_keys, solution_keys
from workbench.fitting.calibration_plans.plan_file import NAME as PLAN
from workbench.fitting.calibration_plans.plan_file import plan_text
from workbench.fitting.calibration_plans.plans import base_and_tool, geometry
from workbench.fitting.verdicts.diagnosis_verdict import NOISE_LEVELS
from workbench.jobs.robot.calibrate import calibrate
from workbench.jobs.robot.corrected_scene import SCENE, corrected_scene, write_scene

_IMAGES = "a diagnosis of images corrects a sensor, which a plan of an arm does not hold"
_NO_LAW = "{title}: not contained, since no law was found for it"
_NOT_PREDICTED = "{title}: not contained, since it describes the noise and changes no prediction"
_NOMINAL = (
    "the nominal arm with estimated base and tool: an estimated geometry predicts unseen poses no better "
    "(held-out RMS error {fitted:.4g} mm; nominal geometry {nominal:.4g} mm)"
)
_NOT_CONSIDERED = (
    "the uncertainty of the corrected model does not contain the terms that were found and not retained, since the "
    "model with them cannot be calibrated: {problem}"
)


@dataclass(frozen=True)
class ModelFiles:
    """Names of the files that were written, None where one was not; `left_out`: sentences that say what is missing."""

    plan: str | None = None
    solution: str | None = None
    scene: str | None = None
    held_out_rms_mm: float | None = None
    left_out: tuple[str, ...] = ()

    def as_json(self, run: Path) -> dict:
        """The key `model` of the answer; run: the folder in which the files will stand."""
        files = {"plan": self.plan, "solution": self.solution, "scene": self.scene}
        paths = {key: None if name is None else str(run / name) for key, name in files.items()}
        return {
            **paths,
            "held_out_rms_mm": self.held_out_rms_mm,
            "left_out": list(self.left_out),
        }


def corrected_stages(diagnosis: Diagnosis, robot) -> tuple[Stage, ...]:
    """Stages of a plan: geometry, what the baseline already held, and one a term that was kept; all of them stay."""
    loss = "huber" if diagnosis.outliers else "linear"
    stages = [replace(geometry(robot), loss=loss)]
    if diagnosis.given:
        rows = tuple(_row(effect) for effect in diagnosis.given)
        why = f"the baseline of the diagnosis, {diagnosis.baseline}, holds these effects"
        stages.append(Stage("baseline", why, rows, loss=loss, earn=False))
    for term in diagnosis.terms:
        rows = tuple(_row(effect) for effect in term.finding.effects)
        if rows:
            name = f"{term.finding.where}.{term.finding.effect}"
            stages.append(Stage(name, term.statement or name, rows, loss=loss, earn=False))
    return tuple(stages)


def _row(effect) -> tuple[str, str, dict]:
    name = next(key for key, kind in CATALOGUE.items() if kind is type(effect))
    return name, effect.where, dict(effect.options)


def corrected_recording(diagnosis: Diagnosis, recording):
    """The recording with the robot that the diagnosis used: that of the reference, where it named one."""
    if diagnosis.robot_keys is None:
        return recording
    return replace(recording, robot=dict(diagnosis.robot_keys))


def write_model(
    diagnosis: Diagnosis,
    recording,
    folder: Path,
    progress: Callable[[str], None] = lambda text: None,
    trust_data: bool = False,
) -> ModelFiles:
    """Write plan.toml, solution.json and scene.toml of the corrected model into the run folder of a diagnosis."""
    if diagnosis.unit != "mm":
        return ModelFiles(left_out=(_IMAGES,))
    recording = corrected_recording(diagnosis, recording)
    robot = load_robot(robot_keys(recording), "recording.toml, key robot")
    stages = corrected_stages(diagnosis, robot)
    folder = Path(folder)
    omissions = [
        (_NO_LAW if t.finding.effect == "unknown" else _NOT_PREDICTED).format(title=t.title)
        for t in diagnosis.terms
        if not t.finding.effects
    ]
    progress("the corrected model")
    try:
        calibration = calibrate(recording, stages, trust_data=trust_data)
        fitted = calibration.held_out["rms_mm"]
        nominal = calibration.nominal["rms_mm"]
        if len(stages) == 1 and not fitted < nominal:
            omissions.append(_NOMINAL.format(fitted=fitted, nominal=nominal))
            stages = (replace(base_and_tool(), loss=stages[0].loss),)
            calibration = calibrate(recording, stages, trust_data=trust_data)
    except InputError as problem:
        _write_plan(diagnosis, stages, folder)
        return ModelFiles(PLAN, left_out=(*omissions, f"no solution.json: {problem}"))
    _write_plan(diagnosis, stages, folder)
    keys = solution_keys(calibration) | {"diagnosis_std": estimated_std(diagnosis.terms)}
    keys |= _found_noise(diagnosis, keys["noise_rms_mm"])
    try:
        considered = considered_terms(diagnosis.refused, calibration, stages, _row)
    except InputError as problem:
        considered = None
        omissions.append(_NOT_CONSIDERED.format(problem=problem))
    if considered is not None:
        keys["considered"] = considered.as_json()
    (folder / SOLUTION).write_text(json.dumps(keys, indent=1), encoding="utf-8")
    title = f"{diagnosis.title}: corrected by the diagnosis"
    why = write_scene(corrected_scene(calibration, title), folder)
    missing = (f"no scene.toml: {why}",) if why else ()
    held_out = calibration.held_out["rms_mm"]
    return ModelFiles(PLAN, SOLUTION, None if why else SCENE, held_out, (*omissions, *missing))


def _found_noise(diagnosis: Diagnosis, stated_rms: float | None) -> dict:
    """Keys of a solution.json on a noise that the diagnosis found instead of the stated one; none elsewhere."""
    is_found = any(term.finding.effect in NOISE_LEVELS for term in diagnosis.terms)
    if not is_found or not stated_rms:
        return {}
    noise = {"rms_mm": diagnosis.proof.noise, "source": diagnosis.proof.noise_from}
    return {"noise": noise, "noise_factor": diagnosis.proof.noise / stated_rms}


def estimated_std(terms) -> dict[str, float]:
    """Standard deviations of the effects' parameters as the diagnosis states them, by key; mm, rad.

    The plan fixes what the diagnosis estimated: options that are real numbers (an order, an instant), and which other
    terms act. `covariance` is that of predictions by the model as it is; a parameter by itself is less certain.
    """
    rows = [row for term in terms for row in term.parameters if "conditional_std" in row]
    return {row["key"]: float(row["std"]) for row in rows if np.isfinite(row["std"])}


def _write_plan(diagnosis: Diagnosis, stages, folder: Path) -> None:
    (folder / PLAN).write_text(plan_text(stages, _comment(diagnosis)), encoding="utf-8")


def _comment(diagnosis: Diagnosis) -> str:
    term_count = sum(bool(term.finding.effects) for term in diagnosis.terms)
    return (
        f"Plan of the model that `workbench diagnose` found for {diagnosis.recording}: "
        f"{diagnosis.verdict}, {term_count} terms.\n"
        "Calibrate by it: workbench calibrate RECORDING --plan plan.toml"
    )


__all__ = ["ModelFiles", "corrected_recording", "corrected_stages", "write_model"]
