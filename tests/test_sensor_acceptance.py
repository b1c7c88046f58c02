"""The acceptance report: values as defined, what is unknown said so, and no verdict without a limit."""

import numpy as np
import pytest

from ball_scenes import cap
from sensors.acceptance import (
    BEYOND_LIMIT,
    NOT_JUDGED,
    UNDECIDED,
    UNKNOWN,
    WITHIN_LIMIT,
    Probed,
    acceptance,
    probing_form,
    with_verdict,
)
from sensors.ball.extent import shell
from sensors.ball.fit import fit_ball
from workbench.core.errors import InputError

RADIUS, SIGMA = 12.7, 0.01
CENTRES = np.array([[0, 0, 300], [100, 0, 300], [0, 80, 310.0]]).T


@pytest.fixture(scope="module")
def balls():
    """Three balls; the second measured 0.05 mm too far off, the third 0.02 mm too large."""
    random, made = np.random.default_rng(0), []
    for k, size in enumerate((RADIUS, RADIUS, RADIUS + 0.02)):
        points = cap(20_000, np.pi / 3, size) + CENTRES[:, k, None] + [[0.05 * (k == 1)], [0], [0]]
        points += random.normal(0, SIGMA, points.shape)
        made.append(
            Probed(
                k + 1,
                points,
                fit_ball(points, view=[0, 0, 1], incidence=np.deg2rad(55)),
                RADIUS,
                1e-4,
            )
        )
    return made


@pytest.fixture(scope="module")
def plane():
    random = np.random.default_rng(1)
    return np.vstack([random.uniform(-50, 50, (2, 10_000)), 300 + random.normal(0, SIGMA, 10_000)])


def named(lines):
    return {one.name: one for one in lines}


def test_values_are_those_of_the_definitions(balls, plane):
    """Normal noise: 95 % within 3.92 sigma, 99.7 % within 5.94."""
    found = named(acceptance(balls, CENTRES, plane, [19.5, 20.5, 21.0]))
    assert all(one.determined and one.definition and one.n > 0 for one in found.values())
    assert found["probing_form"].value == pytest.approx(3.92 * SIGMA, rel=0.03)
    assert found["probing_range"].value == pytest.approx(5.94 * SIGMA, rel=0.05)
    assert found["probing_rms"].value == pytest.approx(SIGMA, rel=0.02)
    assert found["flat_form"].value == pytest.approx(3.92 * SIGMA, rel=0.03)
    assert found["flat_range"].value == pytest.approx(5.94 * SIGMA, rel=0.06)
    assert found["probing_size"].value == pytest.approx(0.04, abs=4 * found["probing_size"].std)
    assert abs(found["probing_size"].parts["ball-1"]) < 0.005
    spacing = found["sphere_spacing"]
    assert (
        spacing.value == pytest.approx(0.05, abs=0.002) and spacing.n == 3 and spacing.std < 0.001
    )
    assert abs(spacing.parts["ball-1 to ball-3"]) < 0.003
    trimmed = np.mean(np.concatenate([one.fit.reason for one in balls]) > 0)
    assert (
        found["rejected"].value == pytest.approx(trimmed)
        and found["rejected"].parts["incidence"] > 0.1
    )
    assert (
        found["temperature"].value == pytest.approx(20.333, abs=0.001)
        and found["temperature"].parts["range"] == 1.5
    )


def test_symbols_are_those_of_the_standards(balls, plane):
    found = named(acceptance(balls, CENTRES, plane))
    assert found["probing_form"].symbol.startswith("P_Form.Sph.D95%:")
    assert (
        found["probing_size"].symbol.startswith("P_Size.Sph.All:")
        and found["probing_size"].vdi == "PS"
    )
    assert (
        found["sphere_spacing"].vdi == "SD"
        and found["flat_range"].vdi == "F"
        and found["probing_range"].vdi == "PF"
    )


def test_outliers_count_in_the_form_but_not_in_the_rms(balls):
    """Two points of a hundred far off: the shell of 95 % hardly widens, the range does not forgive them."""
    points = balls[0].points.copy()
    points[2, ::50] -= 0.5
    one = Probed(1, points, fit_ball(points))
    found = named(acceptance([one]))
    assert found["probing_range"].value > 0.4 and found["probing_rms"].value < 1.1 * SIGMA
    assert probing_form([one]).value < 0.1 and found["rejected"].parts["outlier"] == pytest.approx(
        0.02, abs=0.001
    )


def test_the_artefacts_own_uncertainty_is_added_to_that_of_the_centres(balls):
    """As the root of the sum of squares, and it decides whether a limit is kept."""
    measured, whole = (
        named(acceptance(balls, CENTRES, artefact_std=std))["sphere_spacing"]
        for std in (0.0, 0.005)
    )
    assert (
        whole.std == pytest.approx(np.hypot(measured.std, 0.005)) and whole.std > 5 * measured.std
    )
    limit = abs(whole.value) + 0.004
    assert (
        with_verdict(measured, limit).verdict == WITHIN_LIMIT
        and with_verdict(whole, limit).verdict == UNDECIDED
    )


def test_the_form_refers_to_the_ball_of_least_squares():
    """A tenth of the points 0.2 mm outside, round the edge: they move that ball, and not the robust one."""
    points = cap(20_000, np.pi / 3, RADIUS)
    edge = np.argsort(points[2])[-2000:]
    points[:, edge] *= 1 + 0.2 / RADIUS
    points += np.random.default_rng(3).normal(0, SIGMA, points.shape)
    one = Probed(1, points, fit_ball(points), RADIUS)
    assert np.abs(one.fit.centre).max() < 0.005 and one.fit.rejected["outlier"] > 1900
    away = np.vstack(
        [points / RADIUS, np.ones(20_000)]
    )  # one linear least-squares step is enough at this size
    move = np.linalg.lstsq(away.T, np.linalg.norm(points, axis=0) - RADIUS, rcond=None)[0]
    found = named(acceptance([one]))
    left = np.sort(np.linalg.norm(points - move[:3, None], axis=0))
    assert found["probing_form"].value == pytest.approx(
        (left[19_000 - 1 :] - left[:1001]).min(), rel=0.03
    )
    robust = shell(np.linalg.norm(points - one.fit.centre[:, None], axis=0), 0.95)
    assert abs(found["probing_form"].value - robust) > 0.02
    assert (
        found["probing_size"].value == pytest.approx(2 * move[3], rel=0.05) and abs(move[3]) > 0.02
    )


def test_what_cannot_be_determined_says_why(balls):
    nothing = acceptance()
    assert not any(one.determined for one in nothing) and all(one.why for one in nothing)
    found = named(acceptance([Probed(1, balls[0].points, balls[0].fit)], CENTRES))
    assert found["probing_size"].why == "no calibrated radius was given"
    assert found["sphere_spacing"].why == "fewer than two balls were measured"
    assert found["temperature"].why == "no temperature was recorded"
    failed = fit_ball(np.zeros((3, 2)))
    assert (
        "was fitted" in named(acceptance([Probed(1, np.zeros((3, 2)), failed)]))["probing_form"].why
    )


def test_nothing_passes_without_a_limit(balls, plane):
    assert all(
        one.verdict == NOT_JUDGED and one.limit is None
        for one in acceptance(balls, CENTRES, plane, 20.0)
    )


def test_a_limit_is_judged_with_the_uncertainty(balls):
    found = named(
        acceptance(
            balls, CENTRES, limits={"sphere_spacing": 0.02, "probing_form": 0.1, "flat_form": 0.1}
        )
    )
    assert (
        found["sphere_spacing"].verdict == BEYOND_LIMIT
        and found["probing_form"].verdict == WITHIN_LIMIT
    )
    assert found["flat_form"].verdict == UNKNOWN and found["probing_size"].verdict == NOT_JUDGED
    spacing = found["sphere_spacing"]
    assert with_verdict(spacing, abs(spacing.value) + spacing.std).verdict == UNDECIDED
    assert with_verdict(spacing, abs(spacing.value) + 3 * spacing.std).verdict == WITHIN_LIMIT


def test_a_limit_or_a_ball_of_no_such_name_is_named(balls):
    with pytest.raises(InputError, match="limits: expected names among .* found 'roundness'"):
        acceptance(balls, limits={"roundness": 0.1})
    with pytest.raises(InputError, match="ball 3: expected one of the 2 balls"):
        acceptance(balls, CENTRES[:, :2])
