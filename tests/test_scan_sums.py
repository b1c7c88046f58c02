"""Warnings on all balls of a scan: what is significant and moves a centre is said, and nothing else."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ball_scenes import cap
from scanner_kinds import SCANNER
from sensors.ball.fit import fit_ball
from sensors.scanner.residuals.misfit import Misfit
from workbench.fitting.verdicts.diagnosis_verdict import check_diagnosis
from workbench.fitting.verdicts.sensor_verdict import scan_verdict, scan_warnings
from workbench.jobs.sensor.scan import Ball, Scan

RADIUS, NOISE = 15.0, 0.02
CENTRES = {1: np.array([0.0, 0.0, 130.0]), 2: np.array([40.0, 9.0, 130.0])}
NONE = Misfit(0.02, 0.001, 0.001, 0.001, 0.5, 6)
LARGE = Misfit(0.02, 0.3, 0.0, 0.0, 0.0, 4)
SMALL = Misfit(0.02, 0.017, 0.0, 0.0, 0.0, 4)


def ball(number, misfit=NONE, radius=RADIUS, seed=0):
    """A ball of the certificate with its lack of fit, whose true radius is `radius`."""
    rng = np.random.default_rng(seed + number)
    points = cap(400, np.pi / 3, radius) + CENTRES[number][:, None]
    points = points + rng.normal(0, NOISE, points.shape)
    fit = fit_ball(points, NOISE, RADIUS, start=[*CENTRES[number], RADIUS])
    return Ball(number, RADIUS, fit, fit.free, points, points[:2], False, misfit)


def scans(*balls, certified=CENTRES, frame_mm=0.0):
    """Scans with one scan of these balls; frame_mm: 1 sigma of the frame of the camera."""
    frame = np.diag([frame_mm**2] * 3 + [0.0] * 3)
    scan = Scan("a", {}, 400, "", np.zeros((3, 0)), {}, balls, "")
    known = {number: (*place, RADIUS) for number, place in certified.items()}
    return SimpleNamespace(
        scans=[scan],
        scanner=replace(SCANNER, frame=frame),
        recording=SimpleNamespace(balls=known),
        cache={},
    )


def test_balls_as_they_should_be_give_no_warning():
    made = scans(ball(1), ball(2))
    assert scan_warnings(made) == []
    assert "not random" not in scan_verdict(made).sentence


def test_lack_of_fit_is_said_of_the_balls_that_could_be_tested():
    (said,) = scan_warnings(scans(ball(1, LARGE), ball(2, None)))
    assert "in 1 of 1 tested balls" in said
    assert "1 with fewer cannot be tested" in said


@pytest.mark.parametrize("frame_mm, warnings", [(0.0, 1), (0.3, 0)])
def test_lack_of_fit_that_hardly_moves_a_centre_is_no_alarm(frame_mm, warnings):
    assert SMALL.is_relevant
    assert len(scan_warnings(scans(ball(1, SMALL), frame_mm=frame_mm))) == warnings


def test_a_residual_below_its_noise_that_is_not_random_is_not_said_to_be_above_it():
    coarse = replace(ball(2, None), fit=replace(ball(2).fit, sigma_scale=0.05))
    sentence = scan_verdict(scans(ball(1, LARGE), coarse)).sentence
    assert "it is not larger than" in sentence and "not random" in sentence
    assert "times" not in sentence


def test_a_radius_that_differs_is_said_with_its_size():
    (said,) = scan_warnings(scans(ball(1, radius=RADIUS - 0.1), ball(2)))
    assert "radius of 1 of 2 balls differs" in said
    assert "scan a, ball 1: 14.9" in said and "instead of 15.0000 mm" in said


def test_balls_that_are_not_as_far_apart_as_stated_are_named():
    wrong = {**CENTRES, 2: CENTRES[2] + [35.0, 0.0, 0.0]}
    (said,) = scan_warnings(scans(ball(1), ball(2), certified=wrong))
    assert "balls 1 and 2: 75.538 mm stated, 4" in said
    assert "artefact.csv" in said


@pytest.mark.parametrize(
    "source", ["from neighbouring points", "from neighbouring points and jitter"]
)
def test_the_noise_of_a_sensor_is_compared_with_what_a_diagnosis_leaves(source):
    """The table lists this noise: a verdict that none is known would contradict it."""
    held_out = {"after_px": 0.05, "expected_px": 0.01, "noise_px": 0.01, "noise_from": source}
    answer = {"held_out": held_out, "effects": []}
    made = SimpleNamespace(unit="px", views=None, verdict="unexplained", as_json=lambda: answer)
    verdict = check_diagnosis(made, None).verdict
    assert f"it is 5 times the noise of 0.01 px ({source})" in verdict.sentence


@pytest.mark.parametrize("overexposed, is_named", [(0, False), (10, False), (300, True)])
def test_overexposure_is_named_where_something_else_is_in_doubt(overexposed, is_named):
    """Or where a ball has too few stripes to be tested; a good ball with full pixels gives no warning."""
    good = replace(ball(1), overexposed=overexposed)
    assert scan_warnings(scans(good)) == []
    for doubtful in (replace(good, misfit=LARGE), replace(good, misfit=None)):
        said = " ".join(scan_warnings(scans(doubtful)))
        assert ("overexposed at" in said) == is_named
        assert ("expose less and scan again" in said) == is_named
