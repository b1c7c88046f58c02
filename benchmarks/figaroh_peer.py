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
        return self.apply_measurement_weighting(
            self._compute_logmap_residuals(self.PEE_measured, estimated)
        )


CHOOSING = 300
"""Points from which figaroh chooses what can be identified.

Its choice (QR with pivoting) keeps 27 parameters from these, which is the whole arm, but 26 from
700, with which it ends at five times the residual: it is helped to the right ones.
"""


def prepared(problem: Problem) -> Calibration:
    """Everything that figaroh does before it solves: choose what can be identified, read the points."""
    logging.disable(logging.WARNING)
    model = pinocchio_model(problem, millimetre=1e-3, point=POINT)
    robot = SimpleNamespace(model=model, data=model.createData(), q0=pin.neutral(model))
    with tempfile.TemporaryDirectory() as folder:
        table, settings = Path(folder, "points.csv"), Path(folder, "settings.yaml")
        settings.write_text(yaml.safe_dump(_settings(str(table))), encoding="utf-8")
        _write(table, Problem(CHOOSING))
        calibration = Calibration(robot, str(settings))
        calibration.calib_config |= {"known_baseframe": False, "known_tipframe": False}
        calibration.initialize()
        _write(table, problem)
        calibration.load_data_set()
    return calibration


def _write(table, problem):
    with table.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["x1", "y1", "z1", *(f"j{k}" for k in range(1, 7))])
        writer.writerows(np.concatenate([problem.points / 1000, problem.variables.T], 1).tolist())


def solved(calibration: Calibration) -> tuple[float, float]:
    """Seconds of figaroh's solve, and the 3-D RMS in mm."""
    calibration.evaluations = 0
    seconds, (result, _) = timed(calibration.solve_optimisation)
    # weighted by 1 / 0.001 m, so that a residual is in millimetres
    return seconds, float(np.sqrt(2 * result.cost / calibration.calib_config["NbSample"]))


def _settings(points):
    joints = [f"j{k}" for k in range(1, 7)]
    task = {
        "type": "kinematic_calibration",
        "joints": {"active_joints": joints},
        "kinematics": {"base_frame": "universe", "tool_frame": "tool"},
        "parameters": {"calibration_level": "full_params"},
        "measurements": {"markers": [{"measurable_dof": [True] * 3 + [False] * 3}]},
        "data": {"number_of_samples": CHOOSING, "source_file": points},
    }
    return {"robot": {"name": "arm"}, "tasks": {"calibration": task}}
