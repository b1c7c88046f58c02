"""Noise of an instrument's angles is found from its direction, and only there."""

from types import SimpleNamespace

import numpy as np
import pytest

from workbench.diagnosis.linear.problem import Finding
from workbench.explanation import answer
from workbench.explanation.noise.angular_noise import direction_test, range_test
from workbench.explanation.result import Term


def _sights(rng, n):
    sight = rng.normal(size=(3, n)) + [[3.0], [0.0], [0.5]]
    return sight / np.linalg.norm(sight, axis=0)


def test_noise_across_the_sight_line_is_found():
    rng = np.random.default_rng(0)
    sight = _sights(rng, 200)
    residual = 0.04 * rng.normal(size=(3, 200))
    residual -= 0.7 * sight * (residual * sight).sum(0)
    p, ratio = direction_test(residual, sight)
    assert p < 1e-6 and 2.5 < ratio < 4.5


def test_noise_without_direction_is_not_found_whatever_its_tails():
    """Of 400 recordings with t4 noise whose size changes from sample to sample about 20 are below 5 %, 4 below 1 %."""
    rng = np.random.default_rng(1)
    found = []
    for _ in range(400):
        sight, scale = _sights(rng, 80), np.exp(rng.normal(size=80))
        found.append(direction_test(scale * rng.standard_t(4, size=(3, 80)), sight)[0])
    found = np.array(found)
    assert 8 <= (found < 0.05).sum() <= 34 and (found < 0.001).sum() <= 2


def test_noise_that_grows_with_the_range_has_its_exponent():
    rng = np.random.default_rng(2)
    distance = rng.uniform(0.5, 4.0, 300)
    p, exponent = range_test(distance * rng.standard_t(5, size=(3, 300)), distance)
    assert p < 1e-8 and abs(exponent - 1) < 0.25
    p, _ = range_test(rng.standard_t(5, size=(3, 300)), distance)
    assert p > 1e-3


@pytest.mark.parametrize(("effect", "judged"), [("unknown", False), ("reading-lag", True)])
def test_the_direction_of_noise_is_not_judged_where_a_function_without_a_law_is_left(
    monkeypatch, effect, judged
):
    """The error of a smooth function that stands for an unknown law has a direction of its own."""
    calls = []
    monkeypatch.setattr(
        answer, "with_angular_noise", lambda terms, *rest: (calls.append(rest), terms)[1]
    )
    monkeypatch.setattr(answer, "residuals_of", lambda problem: None)
    found = SimpleNamespace(
        noise_findings=(), p_first=1e-9, p_remainder=0.5, outliers=np.zeros(3, bool)
    )
    term = Term(Finding(effect, "time", "", (), 1e-9, 1.0, 0.0, 0.0))
    last = SimpleNamespace(found=found, after=None, bench=None, has_rounding=False)
    answer._with_noise(last, (term,), ())
    assert bool(calls) is judged
