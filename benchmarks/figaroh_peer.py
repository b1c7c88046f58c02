"""figaroh's own calibration of the same arm, by way of the files that it reads."""

import csv
import logging
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import yaml
from figaroh.calibration.base_calibration import BaseCalibration
from figaroh.calibration.calibration_tools import calc_updated_fkm

from benchmarks.peers import pinocchio_model
from benchmarks.problem import POINT, Problem
from benchmarks.table import timed


class Calibration(BaseCalibration):
    """The cost function is the one in figaroh's documentation (BaseCalibration, "Example")."""

    evaluations = 0

    def cost_function(self, var):
        self.evaluations += 1
        estimated = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
        return self.apply_measurement_weighting(self._compute_logmap_residuals(self.PEE_measured, estimated))


def prepared(problem: Problem) -> Calibration:
    """Everything that figaroh does before it solves: read the points, choose what can be identified."""
    logging.disable(logging.WARNING)
    model = pinocchio_model(problem, millimetre=1e-3, point=POINT)
    robot = SimpleNamespace(model=model, data=model.createData(), q0=pin.neutral(model))
    with tempfile.TemporaryDirectory() as folder:
        points, settings = Path(folder, "points.csv"), Path(folder, "settings.yaml")
        with points.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["x1", "y1", "z1", *(f"j{k}" for k in range(1, 7))])
            writer.writerows(np.concatenate([problem.points / 1000, problem.variables.T], 1).tolist())
        settings.write_text(yaml.safe_dump(_settings(problem.n, str(points))), encoding="utf-8")
        calibration = Calibration(robot, str(settings))
        calibration.calib_config |= {"known_baseframe": False, "known_tipframe": False}
        calibration.initialize()
    return calibration


def solved(calibration: Calibration) -> tuple[float, float]:
    """Seconds of figaroh's solve, and the 3-D RMS in mm."""
    calibration.evaluations = 0
    seconds, (result, _) = timed(calibration.solve_optimisation)
    # weighted by 1 / 0.001 m, so that a residual is in millimetres
    return seconds, float(np.sqrt(2 * result.cost / calibration.calib_config["NbSample"]))


def _settings(n, points):
    joints = [f"j{k}" for k in range(1, 7)]
    task = {
        "type": "kinematic_calibration",
        "joints": {"active_joints": joints},
        "kinematics": {"base_frame": "universe", "tool_frame": "tool"},
        "parameters": {"calibration_level": "full_params"},
        "measurements": {"markers": [{"measurable_dof": [True] * 3 + [False] * 3}]},
        "data": {"number_of_samples": n, "source_file": points},
    }
    return {"robot": {"name": "arm"}, "tasks": {"calibration": task}}
