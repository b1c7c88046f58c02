"""A second line and blooming: rendered, fitted with their sizes, and named by the diagnosis."""

from dataclasses import replace

import numpy as np
import pytest

import sensor_virtual
from sensors.effects.laser import GhostLine
from sensors.effects.optics import Blooming
from sensors.stripe.asymmetry import Profiles, asymmetry
from sensors.stripe.find import find_stripes
from sensors.stripe.second_line import second_line
from simulated_images import simulated
from workbench.diagnosis.scanner import sensor
from workbench.diagnosis.search.select import find
from workbench.explanation.result import AMBIGUOUS, EXPLAINED, verdict_of
from workbench.explanation.sensor_errors import ghost_line_terms, image_terms
from workbench.explanation.sentences.statements import statement
from workbench.fitting.verdicts.line_doubts import LineDoubt

WIDTH = 1.2  # px
NOISE = 0.03  # px, of a single centre
ASYMMETRIC = LineDoubt("asymmetric", "laser", ("line_width",), 1e-9, 0.05, "It is.", GhostLine)


def profiles_of(share: float, offset: float, seed: int) -> Profiles:
    """Profiles of 24 images of slanted lines with a copy of `share` at `offset` px."""
    rng = np.random.default_rng(seed)
    column, row = np.meshgrid(np.arange(60.0), np.arange(120.0))
    images = []
    for _ in range(24):
        distance = column - rng.uniform(25, 30) - rng.uniform(-0.05, 0.05) * row
        line = np.exp(-0.5 * (distance / WIDTH) ** 2)
        copy = share * np.exp(-0.5 * ((distance - offset) / WIDTH) ** 2)
        images.append(10 + 150 * (line + copy))
    light = np.array(images)
    noisy = light + rng.normal(size=light.shape) * np.sqrt(1 + 0.02 * light)
    stack = np.clip(np.round(noisy), 0, 255).astype(np.uint8)
    return Profiles.of(stack, find_stripes(stack))


@pytest.mark.parametrize(("share", "offset"), [(0.2, 1.4), (0.3, -1.6), (0.1, 2.4)])
def test_a_second_line_is_found_with_its_brightness_and_distance(share, offset):
    profiles = profiles_of(share, offset, 3)
    assert asymmetry(profiles).is_relevant(NOISE)
    found = second_line(profiles)
    # centres are fitted within a window, which cuts a part of a copy beyond two widths
    assert found.share == pytest.approx(share, abs=max(4 * found.std[0], 0.15 * share))
    least = 0.05 * abs(offset)
    assert found.offset_px == pytest.approx(offset, abs=max(4 * found.std[1], least))
    assert np.sign(found.shift_px) == np.sign(offset)


def test_a_resolved_second_line_is_no_asymmetric_beam():
    assert second_line(profiles_of(0.1, 3.6, 5)).probability > 0.95


def test_a_single_line_is_symmetric():
    assert not any(asymmetry(profiles_of(0.0, 1.0, seed)).is_relevant(NOISE) for seed in range(5))


@pytest.mark.parametrize("offset", [0.1, -0.25])
def test_the_law_is_what_a_second_line_does_to_a_fitted_centre(offset):
    place = np.linspace(-2, 2, 4001)
    share, width = 1e-3, 0.2
    line = np.exp(-0.5 * (place / width) ** 2)
    light = line + share * np.exp(-0.5 * ((place - offset) / width) ** 2)
    slope = line * place / width**2  # derivative by the centre
    shift = slope @ (light - line) / (slope @ slope)
    state = sensor_virtual.chains().board_stripes.state
    law = GhostLine("laser", offset, width_mm=width)
    np.testing.assert_allclose(law.delta(np.array([share]), state), -shift, rtol=1e-3)


def test_a_second_line_is_a_finding_with_an_asymmetric_beam_as_alternative():
    second = second_line(profiles_of(0.2, 1.4, 3))
    chains = replace(sensor_virtual.chains(), line_doubts=(ASYMMETRIC,), second_line=second)
    bench = sensor.SensorBench(chains)
    (term,) = image_terms(bench, (), bench.problem(()))
    assert (term.finding.effect, term.finding.where) == ("ghost-line", "laser")
    assert [a.effect for a in term.finding.alternatives] == ["unknown"]
    assert verdict_of((term,), 1.0) == AMBIGUOUS
    assert "that of two lines" in statement(term, "the ball", "px")
    resolved = replace(chains, second_line=second_line(profiles_of(0.1, 3.6, 5)))
    (term,) = ghost_line_terms(sensor.SensorBench(resolved), ())
    assert verdict_of((term,), 1.0) == EXPLAINED
    assert not ghost_line_terms(bench, (Blooming("camera"),))


def with_brightness(chains, seed: int):
    """Chains with brightness and width of the line that change from point to point, as on the squares of a board."""
    rng = np.random.default_rng(seed)

    def of(chain):
        brightness = rng.choice([-0.8, 0.8], chain.n)
        width = 0.1 * brightness + rng.normal(0, 0.03, chain.n)
        more = {"line_brightness": brightness, "line_width": width}
        return replace(chain, covariates={**chain.covariates, **more})

    stripes, balls = of(chains.board_stripes), of(chains.balls)
    return replace(chains, board_stripes=stripes, balls=balls)


def test_blooming_is_named_with_its_size():
    chains = with_brightness(sensor_virtual.chains(), 4)
    values = {"camera.blooming.brightness": 0.15, "camera.blooming.width": 0.4}
    bench = sensor.SensorBench(simulated(chains, (Blooming("camera"),), values, 8))
    found = find(bench)
    assert [(f.effect, f.where) for f in found.findings] == [("blooming", "camera")]
    for row in bench.parameters(found.findings[0].effects):
        assert row["value"] == pytest.approx(values[row["key"]], abs=4 * row["std"])


def test_without_blooming_brightness_explains_nothing():
    chains = with_brightness(sensor_virtual.chains(), 4)
    bench = sensor.SensorBench(simulated(chains, (), {}, 9))
    assert find(bench).findings == ()


def test_a_second_line_is_rendered_where_the_law_has_it():
    pytest.importorskip("torch")
    from sensor_bench import CAMERA, board, centroids, instrument
    from sensors.rendering.instrument import Optics
    from sensors.rendering.ports import Moment, make_causes
    from sensors.rendering.render import laser_light

    made = instrument((0.3,), optics=Optics(0.6, 125.0, 0.0))
    made = replace(made, laser=replace(made.laser, source=None))
    row = ("ghost-line", "laser", {"offset_mm": 0.2}, {"share": 0.25})
    with_copy = Moment(make_causes([row], CAMERA, {}, 0))
    centres = []
    for moment in (Moment(), with_copy):
        (light,) = laser_light(made, [board(moment=moment)], [moment])
        centres.append(centroids(light))
    assert np.array_equal(centres[0][0], centres[1][0])
    moved = centres[1][1] - centres[0][1]
    plane = made.nominal_planes()[:, 0]
    pixel = 125.0 / CAMERA.fx * plane[0]  # mm that a pixel moves along the normal, roughly
    assert moved == pytest.approx(0.25 / 1.25 * 0.2 / pixel, rel=0.15)
