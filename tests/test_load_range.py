"""The range of the mass of an unrecorded load that the poses do not exclude."""

import numpy as np
import pytest

from workbench.diagnosis.search.load_range import MassRange, mass_range


def case(seed, mass, contrast=1.0, n=300):
    """Deflection under links, under a load, and residual by a compliance with a load of `mass` kg.

    contrast: how much the moments of the load differ from those of the links.
    """
    rng = np.random.default_rng(seed)
    links = rng.normal(0, 4.0, n)
    load = np.stack([0.3 * links + contrast * rng.normal(0, 1.0, n), *rng.normal(0, 0.01, (3, n))])
    residual = -(links + mass * load[0]) + rng.normal(0, 1.0, n)
    return links + mass * load[0], load, residual, links


def test_the_range_contains_the_true_mass():
    inside = 0
    for seed in range(60):
        _, load, residual, links = case(seed, 5.0)
        found = mass_range(links, load, residual, 1.0)
        assert np.isfinite(found.high) and found.low > 1
        inside += found.low * 0.89 <= 5.0 <= found.high * 1.13  # steps of the searched masses
    assert inside >= 54


def test_a_load_like_the_links_is_not_determined():
    _, load, residual, links = case(1, 0.0, contrast=0.0)
    found = mass_range(links, load, residual, 1.0)
    assert found.low == 0 and not np.isfinite(found.high)
    assert found.words == "any mass: it is not determined"


def test_no_load_is_within_the_range_where_there_is_none():
    _, load, residual, links = case(2, 0.0)
    found = mass_range(links, load, residual, 1.0)
    assert found.low == 0 and 0 < found.high < 2
    assert found.words.startswith("a mass of up to ")


@pytest.mark.parametrize(
    ("masses", "words"),
    [
        (MassRange(0.5, 6.0), "a mass of 0.5 to 6 kg"),
        (MassRange(0.5, np.inf), "any mass above 0.5 kg"),
    ],
)
def test_a_range_in_words(masses, words):
    assert masses.words == words
