"""A ball or a reflector that is knocked midway is found as its own step, not as opposite steps of base and link."""

import re
from dataclasses import replace

import numpy as np
import pytest

from robot_model.effects.steps import TargetShift
from scenes import model_of, observed, scene
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.select import find
from workbench.explanation.answer import diagnose

INSTANT, STEP_MM = 455.0, (0.15, -0.2, 0.1)
PLACES = {"ball-centre": "ball-2", "external-point": "reflector-5"}


def knocked(measures: str, n: int = 90, seed: int = 8):
    """A recording in which one target moves at an instant; its samples are one of three or four."""
    made = scene(measures, n=n, seed=seed)
    where = PLACES[measures]
    model = model_of(made, ("target-shift", where, {"after": INSTANT}))
    sizes = dict(zip((f"{where}.shift.{axis}" for axis in "xyz"), STEP_MM))
    moved = observed(model, model.parameters.update(sizes), np.random.default_rng(seed))
    points = moved.chain.measurement.measured
    columns = made.recording.columns | dict(zip(("x_mm", "y_mm", "z_mm"), points))
    return replace(made.recording, columns=columns)


@pytest.mark.parametrize("measures", PLACES)
def test_a_target_that_was_knocked_is_one_finding(measures):
    (found,) = find(bench_of(knocked(measures))).findings
    assert (found.effect, found.where) == ("shift", PLACES[measures])
    assert found.probability > 0.9
    assert abs(found.instant.value - INSTANT) <= 3 * found.instant.std
    assert found.instant.std > 10 / np.sqrt(12)  # between two samples of this target
    assert isinstance(found.effects[0], TargetShift)


def test_its_sentence_names_the_samples_of_the_target_itself():
    recording = knocked("ball-centre")
    balls = recording.columns["ball"]
    found = diagnose(recording)
    (text,) = (effect["statement"] for effect in found.as_json()["effects"])
    before, after = map(int, re.search(r"between samples (\d+) and (\d+)", text).groups())
    assert text.startswith("Ball 2 moves once")
    assert balls[before - 1] == balls[after - 1] == 2 and not (balls[before : after - 1] == 2).any()


def test_the_only_target_has_no_step_of_its_own():
    ball = {1: (0.0, 0.0, 0.0, 15.0)}
    chain = bench_of(scene("ball-centre", balls=ball).recording).chain
    assert not list(TargetShift.grids(chain))
