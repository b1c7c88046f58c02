"""Centres that depend on the width and brightness of the line: relevant for blooming, silent for noise and shapes."""

import numpy as np
import pytest

from sensors.scanner.residuals.line_dependence import line_dependence

NOISE, STRIPES, LENGTH = 0.04, 40, 160


def stripes(seed, blooming=0.0, bent=0.0):
    """Residual, stripe label, place and line shape of stripes over the squares of a board; `blooming`: px by which the
    bright squares' centres are off, `bent`: px by which stripes are bent."""
    rng = np.random.default_rng(seed)
    along = np.tile(np.arange(LENGTH, dtype=float), STRIPES)
    label = np.repeat(np.arange(STRIPES), LENGTH)
    bright = (along + 7 * label) // 20 % 2
    width = (0.9 + 0.2 * bright) * np.exp(0.02 * rng.normal(size=along.size))
    ratio = (1 + 5 * bright) * np.exp(0.05 * rng.normal(size=along.size))
    place = along / LENGTH * 2 - 1
    sign = rng.choice([-1.0, 1.0], STRIPES)[label]
    error = NOISE * rng.normal(size=along.size) + blooming * bright + bent * sign * place**2
    return error, label, along, np.stack([width, ratio])


@pytest.mark.parametrize("bent", [0.0, 0.3])
def test_noise_and_bent_stripes_depend_on_no_width(bent):
    found = [line_dependence(*stripes(seed, bent=bent)) for seed in range(30)]
    assert not any(one.is_relevant for one in found)
    assert sum(one.p_value < 0.05 for one in found) <= 5


def test_blooming_is_found_with_its_size():
    found = line_dependence(*stripes(1, blooming=0.3))
    assert found.is_relevant
    assert found.rms_px == pytest.approx(0.15, rel=0.1)  # half of the points, about their mean
    assert found.noise_px == pytest.approx(NOISE, rel=0.1)


def test_a_displacement_far_below_the_noise_is_significant_but_not_relevant():
    found = line_dependence(*stripes(1, blooming=0.2 * NOISE))
    assert found.p_value < 1e-3 and not found.is_relevant


def test_few_stripes_tell_nothing():
    error, label, along, shape = stripes(1)
    few = label < 5
    assert line_dependence(error[few], label[few], along[few], shape[:, few]) is None
