"""The expected error of corrected targets, without a noise that is known, and targets that the arm cannot take."""

import numpy as np
import pytest

from robot_model import load_robot
from scenes import ABB
from test_correction_limits import JOINTS, answer_of, solution
from workbench.files.solution_file import read_solution


def test_the_expected_error_is_without_the_noise_of_the_instrument(workbench, tmp_path):
    """A held-out error of 0.05 mm with a noise of 0.03 mm leaves 0.04 mm for the model: 0.04^2 = 0.05^2 - 0.03^2."""
    text = f"{JOINTS},payload_kg\n0,10,10,0,30,0,1\n"
    solution(tmp_path / "arm", noise_rms_mm=0.03)
    known, _, done = answer_of(workbench, tmp_path, text, status=0)
    assert known["model_error_mm"] == pytest.approx(0.04) and known["noise_mm"] == 0.03
    own = known["sigma_rms_mm"] ** 2 + known["position_left_rms_mm"] ** 2
    assert known["verdict"]["residual"] == pytest.approx((0.04**2 + own) ** 0.5)
    assert "0.03 mm (stated), is no error of the arm" in known["verdict"]["sentence"]
    assert "of which error of the model" in done.stdout


def test_without_a_known_noise_the_expected_error_says_what_it_contains(workbench, tmp_path):
    solution(tmp_path / "arm", noise_rms_mm=None)
    text = f"{JOINTS},payload_kg\n0,10,10,0,30,0,1\n"
    answer, _, _ = answer_of(workbench, tmp_path, text, status=0)
    assert answer["model_error_mm"] is None and answer["verdict"]["residual"] >= 0.05
    assert (
        "contains the noise of the instrument, which is not known" in answer["verdict"]["sentence"]
    )


def test_a_noise_that_the_held_out_error_refutes_is_not_subtracted(workbench, tmp_path):
    """RMS 0.05 mm on 60 unseen samples refutes a noise of 0.075 mm; two samples would not."""
    text = f"{JOINTS},payload_kg\n0,10,10,0,30,0,1\n"
    held_out = {"rms_mm": 0.05, "samples": 60}
    solution(tmp_path / "arm", noise_rms_mm=0.075, held_out=held_out)
    answer, _, _ = answer_of(workbench, tmp_path, text, status=0)
    assert answer["model_error_mm"] is None and answer["noise_mm"] is None
    assert answer["verdict"]["residual"] >= 0.05 and answer["uncertainty_rms_mm"] >= 0.05
    assert "0.075 mm (stated) is not subtracted" in answer["verdict"]["sentence"]
    solution(tmp_path / "arm", noise_rms_mm=0.075, held_out=held_out, replicate_noise_rms_mm=0.03)
    answer, _, _ = answer_of(workbench, tmp_path, text, status=0)
    parameters = 0.03**2 * len(read_solution(tmp_path / "arm").free) / (3 * 60 * (1 - 1 / 2))
    expected = (0.05**2 - 0.03**2 - parameters) ** 0.5
    assert answer["noise_mm"] == 0.03
    assert answer["model_error_mm"] == pytest.approx(expected, rel=0.02)
    assert "0.03 mm (from replicates)" in answer["verdict"]["sentence"]
    solution(tmp_path / "arm", noise_rms_mm=0.075, held_out=held_out | {"samples": 2})
    answer, _, _ = answer_of(workbench, tmp_path, text, status=0)
    assert answer["noise_mm"] == 0.075 and 0 < answer["model_error_mm"] < 0.075


def test_one_error_of_the_model_in_the_whole_answer(workbench, tmp_path):
    """The uncertainty of each target and the verdict combine sigma with the same error of the model."""
    solution(tmp_path / "arm", noise_rms_mm=0.03)
    text = f"{JOINTS},payload_kg\n0,10,10,0,30,0,1\n"
    answer, rows, _ = answer_of(workbench, tmp_path, text, status=0)
    expected = (answer["model_error_mm"] ** 2 + answer["sigma_rms_mm"] ** 2) ** 0.5
    assert float(rows[0]["uncertainty_mm"]) == pytest.approx(expected, rel=1e-3)
    assert float(rows[0]["expanded_uncertainty_mm"]) == pytest.approx(2 * expected, rel=1e-3)
    assert answer["verdict"]["residual"] == pytest.approx(expected, rel=1e-3)
    assert "(RMS, 1 sigma) of the worst target" in answer["verdict"]["sentence"]


def test_the_noise_of_replicates_is_that_of_the_calibration(workbench, tmp_path):
    noise = {"rms_mm": 0.049, "source": "from replicates"}
    solution(tmp_path / "arm", noise=noise, noise_rms_mm=None)
    text = f"{JOINTS},payload_kg\n0,10,10,0,30,0,1\n"
    answer, _, _ = answer_of(workbench, tmp_path, text, status=0)
    assert answer["verdict"]["noise"] == 0.049
    assert "from replicates" in answer["verdict"]["sentence"]


def test_the_expected_error_is_compared_with_the_tolerance(workbench, tmp_path):
    solution(tmp_path / "arm")
    text = f"{JOINTS}\n0,10,10,0,30,0\n"
    for tolerance, status in (("0.1mm", 0), ("0.01", 1)):
        answer, rows, done = answer_of(
            workbench, tmp_path, text, "--tolerance", tolerance, status=status
        )
        assert answer["verdict"]["pass"] is (status == 0)
        assert answer["verdict"]["residual"] == pytest.approx(0.04, rel=0.05)
        assert "Verdict:" in done.stdout and rows[0]["q1_deg"]


def test_a_target_at_the_stretched_elbow_says_why_and_what_to_do(workbench, tmp_path):
    """The calibrated forearm is 0.5 mm shorter: a target that the nominal arm reaches stretched is out of reach."""
    robot = load_robot(ABB)
    forearm, offset = robot.geometry[3, 1], robot.geometry[2, 2]
    stretched = -np.rad2deg(np.arctan2(forearm, offset))
    solution(tmp_path / "arm", changes={"joint-4.d4": forearm - 0.5})
    text = f"{JOINTS},payload_kg\n0,10,{stretched:.4f},0,30,0,1\n0,10,10,0,30,0,1\n"
    answer, rows, _ = answer_of(workbench, tmp_path, text)
    assert answer["unattainable_rows"] == [1] and rows[1]["reached"] == "1"
    (sentence,) = answer["unattainable"]
    assert sentence.startswith("Target 1 has no readings")
    assert "joint 3 is at " in sentence and "degrees away" in sentence
