"""Mistakes that users make are stopped or warned about with the right cause; sound recordings pass without a word."""

from itertools import product

import pytest

from conftest import mostly_slow
from robot_model import load_robot
from user_error_scenes import REAL, SIMULATED, simulated
from user_errors import MISTAKES, RIGHT, is_absorbed, judged
from workbench.fitting.plausibility import check_plausibility

QUICK = (
    "readings rounded to whole degrees",
    "2 % blunders",
    "10 % blunders",
    "a row missing at three quarters",
    "one encoder stuck from the middle on",
    "base, instrument or artefact moved midway",
    "target or sensor slipped midway",
    "instrument set up again midway",
    "a few wrong labels",
    "sigma in m",
    "sigma 1000 times too large",
    "payload in g",
    "temperature in Fahrenheit",
    "time in ms",
    "too few poses",
)
SEARCHED = ("one joint in gon", "z in m", "quaternion as x, y, z, w", "file of another robot")
NAMED = {mistake.name: mistake for mistake in MISTAKES}


def assert_right_cause(mistake, recording):
    made = mistake.make(recording) if recording.measures in mistake.kinds else None
    if made is None:
        pytest.skip(f"'{mistake.name}' cannot be made in this recording")
    if mistake.absorbed(recording):
        pytest.skip(f"not detectable: {mistake.absorbed(recording)}")
    assert judged(mistake, made) in RIGHT, check_plausibility(load_robot(made.robot), made)


@pytest.mark.parametrize("name", SIMULATED)
def test_sound_recordings_are_not_suspected(name):
    recording = simulated(name)
    assert check_plausibility(load_robot(recording.robot), recording) == ()


@pytest.mark.parametrize("name", REAL)
def test_sound_real_recordings_are_not_suspected(name, real):
    recording = REAL[name](real(name))
    assert check_plausibility(load_robot(recording.robot), recording) == ()


@pytest.mark.parametrize(("name", "mistake"), mostly_slow(product(SIMULATED, QUICK), 19, 30))
def test_mistakes_that_residuals_or_stated_values_show(name, mistake):
    assert_right_cause(NAMED[mistake], simulated(name))


@pytest.mark.parametrize(
    ("name", "mistake"), mostly_slow(product(("external-point", "external-pose"), SEARCHED), 2)
)
def test_mistakes_that_are_searched_for(name, mistake):
    assert_right_cause(NAMED[mistake], simulated(name))


@pytest.mark.long
@pytest.mark.parametrize(("name", "mistake"), product(SIMULATED, NAMED))
def test_every_mistake(name, mistake):
    assert_right_cause(NAMED[mistake], simulated(name))


@pytest.mark.long
@pytest.mark.parametrize("name", REAL)
def test_mistakes_in_real_recordings(name, real):
    """At least 95 % of the mistakes that can be detected are stopped or warned about with the right cause."""
    recording = REAL[name](real(name))
    outcomes = {}
    for mistake in MISTAKES:
        made = mistake.make(recording) if recording.measures in mistake.kinds else None
        if made is not None and not mistake.absorbed(recording):
            outcome = judged(mistake, made)
            if outcome != "silent" or not is_absorbed(recording, made):
                outcomes[mistake.name] = outcome
    right = [outcome in RIGHT for outcome in outcomes.values()]
    assert sum(right) >= 0.95 * len(right), outcomes
