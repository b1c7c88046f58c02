"""The sensor's held-out errors hide nothing: poses held by corners, errors by kind, ball centres before and after."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import sensor_virtual
from robot_model.measurements.closure import rigid_fit
from sensors.camera.correlated_errors.displaced_lines import DisplacedLine, HeldOut
from sensors.camera.correlated_errors.shared_effects import BoardLine
from sensors.effects import CATALOGUE
from sensors.light.shared_errors import SharedStripeErrors
from sensors.scanner.residuals.line_dependence import LineDependence
from simulated_images import simulated
from workbench.commands.robot.diagnose import _moved_balls
from workbench.diagnosis.linear.problem import Located
from workbench.diagnosis.scanner import sensor
from workbench.diagnosis.scanner.image_jitter import find_image_jitter
from workbench.diagnosis.scanner.predictions import Predicted, independent_errors, scored_errors
from workbench.diagnosis.search.select import find
from workbench.explanation.answer import _size
from workbench.explanation.result import verdict_of
from workbench.explanation.sensor_errors import (
    ball_centres,
    displaced_line_terms,
    errors_by_kind,
    image_terms,
    image_warnings,
    with_random_errors,
)
from workbench.explanation.sentences.statements import statement
from workbench.explanation.unexplained import (
    contains_unexplained_structure,
    is_remainder_located,
    is_structure_located,
)
from workbench.fitting.verdicts.line_doubts import LineDoubt
from workbench.jobs.sensor.chains import noise_scale

SHIFT = 0.3  # px
DOUBT = LineDoubt(
    "centres move with its brightness", "camera", ("line_brightness",), 1e-9, 0.05, "Expose less."
)


@pytest.fixture(scope="module")
def bench():
    return sensor.SensorBench(simulated(sensor_virtual.chains(), (), {}, 5))


def displaced(placement: int) -> sensor.SensorBench:
    """A bench on whose board pose `placement` all stripes are displaced, which a board pose absorbs in part."""
    chains = simulated(sensor_virtual.chains(), (), {}, 5)
    moved = SHIFT * (chains.board_stripes.labels["placement"] == placement)
    board_stripes = replace(
        chains.board_stripes, pixels=chains.board_stripes.pixels + chains.board_stripes.scan * moved
    )
    # stripes weigh as much as thousands of blurred corners do: a pose fitted to both follows the stripes
    corners = replace(chains.corners, sigma=100 * chains.corners.sigma)
    return sensor.SensorBench(replace(chains, board_stripes=board_stripes, corners=corners))


def test_a_held_out_board_pose_does_not_absorb_the_error_of_its_stripes():
    wrong = displaced(3)
    error = wrong.held_out((), np.where(wrong.pose == 3, 0, -1))
    first = wrong.chains.counts[0]
    stripes = np.arange(wrong.n)[(wrong.pose == 3) & (np.arange(wrong.n) >= first)]
    seen = np.sqrt((error[stripes] ** 2).mean())
    assert seen > 0.9 * SHIFT


def test_noise_and_held_out_error_of_a_clean_scan_are_of_one_size(bench):
    folds = bench.pose % 3
    error = bench.held_out((), folds)
    usual = np.ones(bench.n, bool)
    noise, source = bench.noise(usual)
    weighted = np.sqrt(np.average(error**2, weights=bench.sigma**-2.0))
    assert weighted == pytest.approx(noise, rel=0.25)
    assert source == "from neighbouring points"


def test_errors_by_kind_are_near_the_noise_of_their_kind_on_clean_data(bench):
    error = bench.held_out((), bench.pose % 3)
    proof = SimpleNamespace(errors=np.stack([error, error]))
    rows = errors_by_kind(bench, proof, np.ones(bench.n, bool))
    assert [row["kind"] for row in rows] == ["corners", "stripes on boards", "stripes on balls"]
    for row in rows:
        assert row["before_px"] == pytest.approx(row["noise_px"], rel=0.35)


def test_ball_centres_are_nearer_to_the_truth_with_the_effect_that_was_missing():
    """A scanner with an encoder harmonic: distances between balls are off before, and right with the effect."""
    effect = CATALOGUE["mirror-encoder-harmonic"]("mirror", order=12)
    values = {
        "mirror.mirror-encoder-harmonic.cos12": 4e-4,
        "mirror.mirror-encoder-harmonic.sin12": 3e-4,
    }
    true = sensor_virtual.chains(corner_px=0.001, stripe_px=0.003)
    true = replace(true, scans=tuple(name for name in true.scans for _ in sensor_virtual.RADII))
    wrong = sensor.SensorBench(simulated(true, (effect,), values, 2))
    recording = SimpleNamespace(
        balls={k + 1: (*place, 10.0) for k, place in enumerate(sensor_virtual.PLATE.T)}
    )
    term = SimpleNamespace(finding=SimpleNamespace(effects=(effect,)))
    said = ball_centres(wrong, recording, [term])
    before, after = (
        np.array([row[key] for row in said["centres"]]) for key in ("before_mm", "after_mm")
    )
    assert said["moved_rms_mm"] == pytest.approx(np.sqrt(((after - before) ** 2).sum(1).mean()))
    distances = said["distance_error_rms_mm"]
    assert distances["after"] < 0.6 * distances["before"]
    # the camera's frame is common to all centres: what remains about their mean is the centres' own error
    errors = [
        one - true.balls.centres - (one - true.balls.centres).mean(0) for one in (before, after)
    ]
    assert (errors[1] ** 2).sum() < 0.5 * (errors[0] ** 2).sum()


def test_structure_without_a_place_and_without_a_gain_is_no_finding(bench):
    """The best of many candidates has a small p-value by chance: with no place and no gain nothing is unexplained."""
    empty = Located("sensor", "point", ("u",), 0.0, 1.0, 0.0)
    real = Located("sensor", "point", ("u",), 0.2, 1e-6, 0.1)
    proved = SimpleNamespace(t=0.0, before=0.02)
    assert not is_structure_located(bench, SimpleNamespace(located=(empty,)), (), proved)
    assert is_structure_located(bench, SimpleNamespace(located=(empty, real)), (), proved)
    refused = SimpleNamespace(t_fall=4.0, gain=0.004, finding=SimpleNamespace(p_value=1e-5))
    assert is_structure_located(bench, SimpleNamespace(located=(empty,)), (refused,), proved)
    refused = replace_t(refused, 0.3)
    assert not is_structure_located(bench, SimpleNamespace(located=(empty,)), (refused,), proved)
    assert verdict_of((), 1e-9, is_placed=False) == "consistent"
    assert verdict_of((), 1e-9, is_placed=True) == "unexplained"


def test_a_remainder_without_a_place_leaves_a_finding_as_the_explanation(bench):
    empty = Located("camera", "pixel", ("u",), 0.0, 1.0, 0.0)
    real = Located("camera", "pixel", ("u",), 0.2, 1e-6, 0.1)
    assert not is_remainder_located(bench, SimpleNamespace(remainder=(empty,)))
    assert is_remainder_located(bench, SimpleNamespace(remainder=(empty, real)))


def test_structure_next_to_jitter_alone_counts_as_where_nothing_was_found(bench):
    """Jitter takes nothing off the held-out error, of which therefore everything seems to be left."""
    real = Located("artefact", "target", ("board_x",), 0.01, 1e-3, 0.1)
    jitter = [SimpleNamespace(finding=SimpleNamespace(effects=(), effect="mirror-jitter"))]
    proved = SimpleNamespace(before=0.063, after=0.063, noise=0.055)
    for p_value, expected in ((0.0062, False), (0.001, True)):
        found = SimpleNamespace(remainder=(real,), p_remainder=p_value)
        assert contains_unexplained_structure(bench, found, jitter, proved, False) is expected


def replace_t(term, t):
    return SimpleNamespace(t_fall=t, gain=term.gain, finding=term.finding)


def test_a_refused_term_that_hardly_lowers_the_held_out_error_is_no_structure(bench):
    """Of thousands of points a thousandth of the error is significant, and nothing that needs an explanation."""
    found = SimpleNamespace(
        located=(Located("artefact", "target", ("stage_mm",), 0.004, 1e-5, 0.1),)
    )
    proved = SimpleNamespace(t=0.0, before=0.0143)
    finding = SimpleNamespace(p_value=2e-11)
    for gain, is_structure in ((4e-5, False), (1e-3, True), (None, False)):
        refused = SimpleNamespace(t_fall=2.3, gain=gain, finding=finding)
        assert is_structure_located(bench, found, (refused,), proved) is is_structure


def moved_by(shift_of_stripe) -> sensor.SensorBench:
    """A bench whose stripes are displaced by shift_of_stripe(board pose, step) px."""
    chains = simulated(sensor_virtual.chains(), (), {}, 5)
    labels = chains.board_stripes.labels
    moved = shift_of_stripe(labels["placement"], labels["step"])
    board_stripes = replace(
        chains.board_stripes, pixels=chains.board_stripes.pixels + chains.board_stripes.scan * moved
    )
    return sensor.SensorBench(replace(chains, board_stripes=board_stripes))


def test_a_slope_of_unevenly_spaced_centres_is_no_noise():
    """Centres at dark squares are dropped; what tilts a stripe, as a rolling shutter does, is smooth all the same."""
    stripes = simulated(sensor_virtual.chains(), (), {}, 5).board_stripes
    rng = np.random.default_rng(2)
    along = stripes.stripe_place / np.ptp(stripes.stripe_place)
    uneven = rng.random(stripes.n) < 0.6
    tilted = replace(stripes, pixels=stripes.pixels + stripes.scan * (5 * along + 2 * along**2))
    plain = noise_scale(stripes, "board_stripes")
    assert plain == pytest.approx(1.0, rel=0.1)
    assert noise_scale(tilted.at(uneven), "board_stripes") == pytest.approx(plain, rel=0.1)


def jitter_of(bench):
    return find_image_jitter(bench, (), bench.problem(()))


def test_jitter_of_single_images_is_found_with_its_size_and_a_clean_recording_is_silent(bench):
    table = 0.1 * np.random.default_rng(3).normal(size=(20, 40))
    found = jitter_of(moved_by(lambda placement, step: table[placement, step]))
    assert found.sigma_px == pytest.approx(0.1, rel=0.2)
    assert abs(found.sigma_px - 0.1) < 3 * found.std_px
    assert found.t > 2 and found.p_value < 1e-6
    assert jitter_of(bench) is None


def test_a_displacement_that_follows_the_board_pose_is_no_jitter():
    by_pose = 0.1 * np.random.default_rng(4).normal(size=20)
    assert jitter_of(moved_by(lambda placement, step: by_pose[placement])) is None


def test_a_displacement_that_follows_the_step_is_no_jitter():
    by_step = 0.1 * np.random.default_rng(4).normal(size=40)
    assert jitter_of(moved_by(lambda placement, step: by_step[step])) is None


def test_a_displacement_that_varies_along_the_stripes_is_no_jitter():
    """What a model of the lens leaves displaces stripes, too, and bends them by as much."""
    table = 0.1 * np.random.default_rng(3).normal(size=(20, 40))
    along = simulated(sensor_virtual.chains(), (), {}, 5).board_stripes.stripe_place
    wave = 1 + 1.5 * np.sin(2 * np.pi * along / np.ptp(along))
    assert jitter_of(moved_by(lambda placement, step: table[placement, step] * wave)) is None


def test_jitter_is_found_where_the_calibration_holds_it_as_an_error_that_stripes_share():
    table = 0.1 * np.random.default_rng(3).normal(size=(20, 40))
    chains = moved_by(lambda placement, step: table[placement, step]).chains
    stripes = chains.board_stripes
    shared = SharedStripeErrors.of(stripes.labels, stripes.stripe_place)
    shared = replace(shared, sigma=np.array([0.1, 0.0, 0.0]), std=np.full(3, 0.01))
    held = replace(chains, board_stripes=replace(stripes, shared_errors=shared, _start=None))
    assert jitter_of(sensor.SensorBench(held)) is not None


def test_with_jitter_in_the_noise_a_search_finds_no_law_for_it():
    """Against noise alone, displaced stripes pass for vibration, for an encoder harmonic or for a form of the balls."""
    rng = np.random.default_rng(7)
    chains = simulated(sensor_virtual.chains(boards=8, steps=9, scans=3), (), {}, 5)
    moved = {}
    for name in ("board_stripes", "balls"):
        chain = getattr(chains, name)
        group = chain.labels["placement" if name == "board_stripes" else "ball"]
        shift = 0.1 * rng.normal(size=(60, 40))[group, chain.labels["step"]]
        moved[name] = replace(chain, pixels=chain.pixels + chain.scan * shift)
    bench = sensor.SensorBench(replace(chains, **moved))
    searched = []

    def find_once(one):
        searched.append(one.jitter_px)
        return find(one)

    wider, found = with_random_errors(bench, find_once)
    assert searched == [wider.jitter_px]
    assert wider.jitter_px == pytest.approx(0.1, rel=0.2)
    assert not found.findings and found.p_first > 0.005
    term = image_terms(wider, (), found.before)[0]
    assert term.finding.effect == "mirror-jitter"
    assert "at random from image to image" in statement(term, "the image", "px")


def test_the_size_of_a_term_in_px_does_not_depend_on_the_jitter_of_the_noise():
    effect = CATALOGUE["mirror-encoder-harmonic"]("mirror", order=12)
    true = {"mirror.mirror-encoder-harmonic.cos12": 4e-4}
    bench = sensor.SensorBench(simulated(sensor_virtual.chains(), (effect,), true, 2))
    term = SimpleNamespace(finding=SimpleNamespace(effects=(effect,)))
    sizes = [_size(one, (effect,), term) for one in (bench, bench.with_jitter(0.4))]
    assert sizes[1] == pytest.approx(sizes[0], rel=1e-6) and sizes[0] > 0.05


def test_an_error_that_samples_share_counts_once():
    rng = np.random.default_rng(3)
    factor = rng.normal(size=(300, 6)) * [10.0, 5.0, 0.0, 0.0, 0.0, 0.0]
    noise, moved = rng.normal(size=300), factor[:, 0]  # one standard deviation
    left, log_determinant = independent_errors(noise + moved, factor)
    assert (left**2).sum() < 1.3 * 300
    covariance = np.eye(300) + factor @ factor.T
    assert log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1])
    assert (left**2).sum() == pytest.approx(
        (noise + moved) @ np.linalg.solve(covariance, noise + moved)
    )
    # what no shared error makes stays as it is, and what is far larger than it does not pass for one
    wave = 10 * np.cos(np.arange(300))
    assert np.std(independent_errors(wave, factor)[0]) > 0.95 * np.std(wave)
    assert (independent_errors(50 * moved, factor)[0] ** 2).sum() > 1000
    same, nothing = independent_errors(noise, 0 * factor)
    assert np.array_equal(same, noise) and nothing == 0


def test_scores_of_predictions_are_those_of_their_density():
    """Corners that determine a pose, and stripes that it moves: against the conditional normal density, made whole."""
    rng = np.random.default_rng(4)
    noise, by_own, by_shared, kinds = [0.1, 0.02], [], [], []
    for sigma, count in zip(noise, (40, 25)):
        by_own.append(rng.normal(size=(6, 1, count)))
        by_shared.append(rng.normal(size=(3, 1, count)))
        kinds.append((sigma, count))
    root = rng.normal(size=(3, 3)) * 0.01
    shared = root @ rng.normal(size=3)
    pose, found, errors = rng.normal(size=6), None, []
    for (sigma, count), own, others in zip(kinds, by_own, by_shared):
        error = 0.7 * sigma * rng.normal(size=count) + np.tensordot(pose, own, 1)[0]
        errors.append(error + np.tensordot(shared, others, 1)[0])
    a = by_own[0][:, 0].T
    found = np.linalg.lstsq(a, errors[0], rcond=None)[0]
    predicted = [
        Predicted(
            (error - np.tensordot(found, own, 1)[0])[None],
            np.full((1, count), sigma),
            others,
            own,
            np.zeros(count, int),
        )
        for error, (sigma, count), own, others in zip(errors, kinds, by_own, by_shared)
    ]
    scored = scored_errors(predicted, root @ root.T)
    score = sum(float(((e / p.sigma) ** 2).sum()) for e, p in zip(scored, predicted))
    # the same with a pose of which nothing was known before: its prior is flat
    wide = 1e4
    rows = [
        np.hstack([wide * o[:, 0].T, s[:, 0].T @ root]) / n
        for o, s, n in zip(by_own, by_shared, noise)
    ]
    white = np.concatenate([e / n for e, n in zip(errors, noise)])
    first, whole = rows[0][:, :6], np.concatenate(rows)
    covariance = np.eye(len(white)) + whole @ whole.T
    expected = white @ np.linalg.solve(covariance, white) + np.linalg.slogdet(covariance)[1]
    expected -= np.linalg.slogdet(np.eye(40) + first @ first.T)[1]
    assert score == pytest.approx(expected, rel=1e-3)


def test_a_displaced_row_that_only_the_calibration_of_the_camera_sees_is_a_term(bench):
    row = BoardLine(1, 3, 16.0, np.zeros((2, 0), int))
    tested = HeldOut(8.0, 0.97, (2.0, 1.0), 5, 5)
    found = DisplacedLine(row, np.array([0.0, -0.12]), np.array([1e-3, 1e-3]), tested)
    wider = sensor.SensorBench(replace(bench.chains, lines=(found,)))
    (term,) = displaced_line_terms(wider, ())
    assert (term.finding.probability, term.t, term.reselected_folds) == (0.97, 8.0, 5)
    for missing in (None, replace(tested, t=1.0)):  # no board pose that was left out confirms it
        lines = (replace(found, held_out=missing),)
        unconfirmed = sensor.SensorBench(replace(bench.chains, lines=lines))
        assert displaced_line_terms(unconfirmed, ()) == ()
    assert (term.finding.effect, term.finding.where) == ("board-point-errors", "artefact")
    values = {row["name"]: row["value"] for row in term.parameters}
    assert values == {"row16_x": 0.0, "row16_y": -0.12}
    assert "row at 16 mm" in statement(term, "the image", "px")
    same = CATALOGUE["board-point-errors"]("artefact", line="row", at_mm=16.0)
    other = CATALOGUE["board-point-errors"]("artefact", line="row", at_mm=24.0)
    assert not displaced_line_terms(wider, (same,))
    assert len(displaced_line_terms(wider, (other,))) == 1


def test_a_line_whose_centres_depend_on_its_brightness_is_in_doubt_and_no_jitter(bench):
    table = 0.1 * np.random.default_rng(3).normal(size=(20, 40))
    jittered = moved_by(lambda placement, step: table[placement, step])
    assert jitter_of(jittered) is not None
    assert image_warnings(bench, ()) == ()
    dependence = LineDependence(0.05, 1e-9, 0.04)
    chains = replace(jittered.chains, dependence=dependence, line_doubts=(DOUBT,))
    bright = sensor.SensorBench(chains)
    assert jitter_of(bright) is None
    assert image_warnings(bright, ()) == (DOUBT.sentence,)


def test_structure_of_the_laser_line_is_never_consistent(bench):
    """It is unexplained at its place, unless an effect that was found displaces the line."""
    doubted = sensor.SensorBench(replace(bench.chains, line_doubts=(DOUBT,)))
    problem = doubted.problem()
    (term,) = image_terms(doubted, (), problem)
    assert (term.finding.effect, term.finding.where) == ("unknown", "camera")
    assert term.finding.depends_on == ("line_brightness",)
    assert verdict_of((), 1.0) == "consistent" and verdict_of((term,), 1.0) == "unexplained"
    said = statement(term, "the image", "px")
    assert DOUBT.label in said and "the camera" in said
    assert "the brightness of the laser line" in said
    named = SimpleNamespace(finding=SimpleNamespace(effects=(CATALOGUE["plane-bow"]("laser"),)))
    assert image_terms(doubted, (named,), problem) == ()
    assert image_terms(bench, (), problem) == ()


def test_error_of_ball_centres_does_not_hold_the_motion_of_the_camera_frame():
    """A bowed light plane moves all centres by 0.8 mm, most of it together, which the hand-eye transform absorbs."""
    effect = CATALOGUE["plane-bow"]("laser")
    values = {"laser.plane-bow.curvature": 1e-4}
    true = sensor_virtual.chains(corner_px=0.001, stripe_px=0.003)
    true = replace(true, scans=tuple(name for name in true.scans for _ in sensor_virtual.RADII))
    bowed = sensor.SensorBench(simulated(true, (effect,), values, 2))
    recording = SimpleNamespace(
        balls={k + 1: (*place, 10.0) for k, place in enumerate(sensor_virtual.PLATE.T)}
    )
    term = SimpleNamespace(finding=SimpleNamespace(effects=(effect,)))
    said = ball_centres(bowed, recording, [term])
    before = np.array([row["before_mm"] for row in said["centres"]])
    rotation, translation = rigid_fit(before, true.balls.centres)
    error = np.linalg.norm(true.balls.centres - before @ rotation.T - translation, axis=1)
    assert said["error_rms_mm"] == pytest.approx(np.sqrt((error**2).mean()), rel=0.3)
    assert said["moved_rms_mm"] > 4 * said["error_rms_mm"]
    rows = [row["error_mm"] for row in said["centres"]]
    assert max(rows) == said["error_largest_mm"]
    text = _moved_balls(said)
    assert f"{max(rows):.4f} mm (ball " in text and "hand-eye" in text


def test_centres_without_effects_are_those_of_the_scanner_that_boards_calibrate(bench):
    """Balls that contradict the scanner bend it in a joint solve; they do not bend a scanner calibrated from boards."""
    moved = replace(bench.chains.balls, radii=bench.chains.balls.radii + 0.5)
    wrong = sensor.SensorBench(replace(bench.chains, balls=moved))
    boards = replace(bench.chains, balls=None)
    known = sensor.SensorBench(boards).solve()[1].parameters
    expected = wrong._posed(wrong.chains, (), known).values["ball"]
    np.testing.assert_allclose(wrong.ball_centres(), expected, atol=2e-3)
    assert np.abs(wrong.solve()[1].values["ball"] - expected).max() > 2e-2


@pytest.mark.parametrize("count, scale", [(3, 1.0), (6, 0.0)])
def test_few_balls_or_balls_on_a_line_have_no_error_after_alignment(count, scale):
    rng = np.random.default_rng(0)
    before = rng.normal(size=(count, 3)) * [100.0, scale, scale]
    bench = SimpleNamespace(
        ball_centres=lambda effects=(): before + 0.1 * len(effects),
        chains=SimpleNamespace(
            balls=SimpleNamespace(number=np.zeros(count, int)), scans=("1",) * count
        ),
    )
    effect = CATALOGUE["plane-bow"]("laser")
    term = SimpleNamespace(finding=SimpleNamespace(effects=(effect,)))
    said = ball_centres(bench, SimpleNamespace(balls={}), [term])
    assert said["error_rms_mm"] is None and said["moved_rms_mm"] > 0
    assert "too few balls" in _moved_balls(said)


def test_points_beyond_the_lens_are_counted_among_the_warnings(bench):
    """The camera model has no ray for them; their number and the remedy are stated."""
    counted = sensor.SensorBench(replace(bench.chains, beyond_lens=7))
    (warning,) = image_warnings(counted, ())
    assert warning.startswith("7 points of laser lines are left out")
    assert "show boards up to the edge of the image" in warning


@pytest.mark.parametrize("share, expected", [(0.0024, False), (0.2, True)])
def test_a_small_share_of_what_a_law_leaves_is_no_structure(bench, share, expected):
    """A quarter of a per cent of the remainder is significant in thousands of points, next to a right finding."""
    place = Located("artefact", "target", ("board_x",), share, 1e-3, 0.01)
    found = SimpleNamespace(remainder=(place,), p_remainder=1e-12)
    law = SimpleNamespace(finding=SimpleNamespace(effects=(CATALOGUE["plane-bow"]("laser"),)))
    lines = SimpleNamespace(finding=SimpleNamespace(effects=(), effect="board-point-errors"))
    jitter = SimpleNamespace(finding=SimpleNamespace(effects=(), effect="mirror-jitter"))
    assert is_remainder_located(bench, found, (law,)) is expected
    assert is_remainder_located(bench, found, (lines,)) is expected
    assert is_remainder_located(bench, found, (law, jitter))
    assert is_remainder_located(bench, found, ())


def test_jitter_names_a_vibration_as_its_alternative():
    """A vibration whose frequency the times of the images do not show displaces whole stripes at random, too."""
    table = 0.1 * np.random.default_rng(3).normal(size=(20, 40))
    jittered = moved_by(lambda placement, step: table[placement, step])
    (term,) = image_terms(jittered, (), jittered.problem())
    assert term.finding.effect == "mirror-jitter"
    (alternative,) = term.finding.alternatives
    assert (alternative.effect, alternative.where) == ("mirror-vibration", "mirror")
    assert "time_s" in alternative.why
    assert "vibration" in statement(term, "the image", "px")
