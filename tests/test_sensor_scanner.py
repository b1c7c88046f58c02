"""The joint adjustment of a scanner, its mirror, its file: a simulated copy of Ye's instrument with known truth, and a real one."""

import re
from dataclasses import replace

import numpy as np
import pytest

from conftest import sizes
from plane_scenes import CAMERA, aligned, board, board_stripes, mirror, simulated_scanner, views
from sensors.camera.calibration import calibrate_camera
from sensors.effects import CATALOGUE
from sensors.light.board_chain import BoardStripeChain
from sensors.light.board_stripes import BoardStripes, joined, thinned, wrong_points
from sensors.light.planes import tilt_directions
from sensors.light.shared_errors import SharedStripeErrors
from sensors.scanner.calibration import calibrate_scanner
from sensors.scanner.file import read_scanner, scanner_text, write_scanner
from sensors.scanner.model import Scanner
from workbench.core.errors import InputError


def calibrated(truth, **more):
    camera = calibrate_camera(views(truth), board(), CAMERA.size, folds=0)
    more = {"check": False, "camera": camera, **more}
    return calibrate_scanner(
        views(truth), more.pop("stripes", board_stripes(truth)), board(), CAMERA.size, **more
    )


@pytest.fixture(scope="module")
def truth():
    return simulated_scanner(np.random.default_rng(11), points=20, steps=40)


@pytest.fixture(scope="module")
def made(truth):
    return calibrated(truth)


def whitened(adjustment, truth, steps):
    """Errors of camera and planes, as independent numbers of variance one where the covariance is right."""
    found, real = adjustment.board_stripes.planes, truth.planes[:, steps]
    real = real * np.sign((real[:3] * found[:3]).sum(0))
    tilts = np.einsum("kis,is->ks", tilt_directions(found), found[:3] - real[:3])
    error = np.r_[
        adjustment.camera.values - truth.camera.values,
        np.vstack([tilts, found[3] - real[3]]).T.ravel(),
    ]
    factor = adjustment.joint()
    size = np.sqrt((factor**2).sum(1))
    values, vectors = np.linalg.eigh((factor @ factor.T) / np.outer(size, size))
    known = values > 1e-9 * values[-1]
    return vectors[:, known].T @ (error / size) / np.sqrt(values[known])


def test_planes_are_found_to_a_thousandth_of_a_millimetre_and_the_mirror_finds_them_better(
    made, truth
):
    steps = made.scanner.steps
    free = aligned(truth, made.free.camera, made.free.board_stripes.planes, steps=steps)
    pooled = aligned(truth, made.camera, made.scanner.planes, steps=steps)
    assert made.mirror.supported and made.scanner.mirror is not None
    assert pooled[0] < free[0] < 0.001
    assert made.best_frame.point_mm < 0.7 * made.free.best_frame(made.volume).point_mm
    assert (
        abs(made.camera.fx - truth.camera.fx) < 3 * made.std["camera.fx"] < 3e-3 * truth.camera.fx
    )


def test_stated_sigmas_cover_the_truth(made, truth):
    for adjustment in (made.free, made.made):
        z = whitened(adjustment, truth, made.scanner.steps)
        assert (z**2).mean() == pytest.approx(1, abs=4 * np.sqrt(2 / len(z)))


@pytest.mark.parametrize("count", sizes(6, 24))
def test_stated_sigmas_cover_the_truth_in_68_percent_over_seeds(count):
    free, pooled, points = [], [], []
    for seed in range(count):
        scene = simulated_scanner(np.random.default_rng(100 + seed), points=25, steps=40)
        found = calibrated(scene)
        free.append(whitened(found.free, scene, found.scanner.steps))
        pooled.append(whitened(found.made, scene, found.scanner.steps))
        points.append(
            [
                aligned(scene, found.camera, found.scanner.planes, steps=found.scanner.steps)[1],
                found.best_frame.point_mm,
            ]
        )
    for z in (np.concatenate(free), np.concatenate(pooled)):
        assert 0.62 < (np.abs(z) < 1).mean() < 0.74
    error, stated = np.sqrt((np.array(points) ** 2).mean(0))
    assert error == pytest.approx(stated, rel=0.25)


@pytest.mark.slow
def test_the_whole_simulated_scanner_with_120_planes():
    scene = simulated_scanner(np.random.default_rng(0))
    found = calibrated(scene, check=True)
    distance, error = aligned(scene, found.camera, found.scanner.planes, steps=found.scanner.steps)
    assert distance < 0.0005 and error < 0.001
    assert found.mirror.supported and found.mirror.difference_mm < 2 * found.mirror.expected_mm
    assert found.left_out.share > 0.99 and found.left_out.rms_px == pytest.approx(0.1, rel=0.1)
    assert found.sigma_stripe_px == pytest.approx(
        0.1, rel=0.02
    ) and found.sigma_corner_px == pytest.approx(0.06, rel=0.05)


def test_weights_come_from_the_residuals(made):
    assert made.sigma_stripe_px == pytest.approx(0.1, rel=0.02)
    assert made.sigma_corner_px == pytest.approx(0.06, rel=0.05)


def test_sigmas_do_not_depend_on_those_that_were_stated(truth, made):
    other = calibrated(truth, stripes=board_stripes(truth, sigma=0.5))
    assert other.best_frame.point_mm == pytest.approx(made.best_frame.point_mm, rel=0.02)
    assert np.abs(other.scanner.planes - made.scanner.planes).max() < 1e-4


def test_a_mirror_that_shakes_is_refused_and_the_free_planes_are_used():
    scene = simulated_scanner(np.random.default_rng(12), points=25, steps=40, shake=0.001)
    found = calibrated(scene)
    assert not found.mirror.supported and found.mirror.probability < 1e-6
    assert found.scanner.mirror is None
    assert found.mirror.difference_mm > 1.5 * found.mirror.expected_mm
    assert any(
        "it is refused and the free planes are used" in sentence for sentence in found.sentences
    )
    assert aligned(scene, found.camera, found.scanner.planes, steps=found.scanner.steps)[0] < 0.001


@pytest.mark.slow
def test_a_wobble_of_one_and_two_cycles_per_revolution_is_a_differently_placed_mirror():
    values = np.random.default_rng(5).normal(size=8) * np.tile([1e-3, 0.1], 4)
    scene = simulated_scanner(np.random.default_rng(13), points=20, steps=30, wobble=values)
    found = calibrated(scene)
    assert found.mirror.supported
    assert aligned(scene, found.camera, found.scanner.planes, steps=found.scanner.steps)[0] < 0.001


def test_unknown_angles_are_steps_of_one_unknown_turn():
    scene = simulated_scanner(np.random.default_rng(14), points=20, steps=30)
    found = calibrated(scene, stripes=board_stripes(scene, angles=False))
    turn = np.deg2rad(10) / 29
    assert found.mirror.supported and "gain" in found.mirror.fitted
    assert found.mirror.gain == pytest.approx(turn, rel=5 * found.mirror.std["gain"])
    assert any("is not identifiable from these images" in sentence for sentence in found.sentences)


def test_angles_of_the_light_instead_of_the_mirror_are_noticed():
    scene = simulated_scanner(np.random.default_rng(15), points=20, steps=12, sweep=np.deg2rad(8))
    found = calibrated(
        scene, stripes=replace(board_stripes(scene), mirror=2 * scene.angles[scene.step])
    )
    assert any(
        "as if mirror_deg were the angle of the light" in sentence for sentence in found.sentences
    )


def test_a_profiler_is_one_step_and_every_board_pose_is_left_out_once():
    scene = simulated_scanner(np.random.default_rng(16), points=120, steps=1)
    found = calibrated(scene, check=True)
    assert found.mirror is None and found.scanner.planes.shape == (4, 1)
    assert found.left_out.folds == 20 and np.isfinite(found.left_out.residual_mm).all()
    # a left-out board pose comes from its corners alone, which adds to the noise of 0.1 px
    assert found.left_out.share > 0.98 and 0.095 < found.left_out.rms_px < 0.13


def test_effects_of_the_light_are_found_too():
    scene = simulated_scanner(np.random.default_rng(17), points=60, steps=3)
    bow = 2e-5
    along = tilt_directions(scene.planes)[0]
    chain = BoardStripeChain(
        CAMERA,
        scene.stripes,
        {"placement": scene.placement, "step": scene.step},
        scene.poses,
        scene.planes,
        np.zeros(2),
        1.0,
    )
    place = (along[:, scene.step] * chain.state.points).sum(0)
    moved = scene.stripes - np.array([[1.0], [0.0]]) * bow * place**2 / (chain.at_start.by_pixel[0])
    found = calibrated(replace(scene, stripes=moved), effects=(CATALOGUE["plane-bow"]("laser"),))
    key = "laser.plane-bow.curvature"
    assert found.made.parameters[key] == pytest.approx(bow, abs=4 * found.std[key])
    assert found.std[key] < bow / 10
    assert [effect.effect for effect, _ in found.scanner.effects] == ["plane-bow"]


def test_wrong_points_are_left_out_and_counted(truth, made):
    rng = np.random.default_rng(18)
    stripes = board_stripes(truth)
    bad = rng.random(stripes.n) < 0.05
    pixels = stripes.pixels.copy()
    pixels[0, bad] += rng.uniform(3, 40, bad.sum()) * rng.choice([-1, 1], bad.sum())
    found = calibrated(truth, stripes=replace(stripes, pixels=pixels))
    assert found.wrong.sum() > 0.9 * bad.sum()
    assert aligned(truth, found.camera, found.scanner.planes, steps=found.scanner.steps)[0] < 0.0015
    assert any("far from their stripe centreline" in sentence for sentence in found.sentences)


def test_stripes_where_no_board_is_are_dropped_counted_and_reported(truth):
    stripes = board_stripes(truth)
    lost = stripes.placement == "p03"
    stripes = replace(stripes, placement=np.where(lost, "somewhere", stripes.placement))
    off_board = replace(stripes.at(slice(0, 50)), pixels=np.tile([[1270.0], [1015.0]], 50))
    found = calibrated(truth, stripes=joined([stripes, off_board]))
    assert found.dropped["no board: no usable image of the board in their pose"] == lost.sum()
    assert found.dropped["off the board"] >= 50
    assert any("no usable image of the board" in sentence for sentence in found.sentences)


def test_a_step_seen_at_one_placement_only_has_no_plane(truth):
    stripes = board_stripes(truth)
    lonely = (stripes.step == 20) & (stripes.placement != "p05")
    found = calibrated(truth, stripes=stripes.at(~lonely))
    assert 20 not in found.scanner.steps
    with pytest.raises(InputError, match="step 20: expected one of"):
        found.scanner.reconstruct(np.array([[600.0], [500.0]]), np.array([20]))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda s: replace(s, placement=np.full(s.n, "elsewhere")),
            "expected points of the laser's line on a board",
        ),
        (
            lambda s: replace(s, pixels=s.pixels + 5000),
            "expected points of the laser's line on a board",
        ),
        (lambda s: s.at(s.placement == "p01"), "expected a step seen in 2 board poses"),
        (
            lambda s: replace(s, mirror=s.mirror + 1e-3 * (s.placement == "p01")),
            "expected one mirror_deg, found",
        ),
    ],
)
def test_stripes_that_make_no_plane_get_their_sentence(truth, change, words):
    with pytest.raises(InputError, match=words):
        calibrated(truth, stripes=change(board_stripes(truth)))


def test_stripes_along_rows_and_along_columns_are_not_mixed(truth):
    stripes = board_stripes(truth)
    with pytest.raises(InputError, match="measured in one direction"):
        joined([stripes, replace(stripes, scan_axis="columns")])
    with pytest.raises(InputError, match="found none"):
        joined([])


def test_thinning_keeps_residuals_and_information():
    scene = simulated_scanner(np.random.default_rng(19), points=240, steps=3, placements=4)
    whole = BoardStripeChain(
        CAMERA,
        scene.stripes,
        {"placement": scene.placement, "step": scene.step},
        scene.poses,
        scene.planes,
        np.zeros(2),
        1.0,
    )
    thin, block = thinned(whole, whole.n // 8)
    assert thin.n < whole.n / 7 and block.max() == thin.n - 1
    every = [chain.evaluate(chain.parameters.values, {}) for chain in (whole, thin)]
    mean = np.bincount(block, every[0].residual[0]) / np.bincount(block)
    assert np.abs(mean - every[1].residual[0]).max() < 1e-6
    known = []
    for chain, here in zip((whole, thin), every):
        rows = (
            np.concatenate([here.family_rows("placement"), here.own_rows(np.arange(9))])[:, 0]
            / chain.sigma
        )
        known.append(rows @ rows.T)
    ratio = np.diag(known[1]) / np.diag(known[0])
    assert (ratio > 0.995).all() and (ratio < 1.001).all()


def test_thinned_stripes_keep_the_errors_that_their_points_share():
    scene = simulated_scanner(np.random.default_rng(19), points=240, steps=3, placements=4)
    labels = {"placement": scene.placement, "step": scene.step}
    whole = BoardStripeChain(
        CAMERA, scene.stripes, labels, scene.poses, scene.planes, np.zeros(2), 1.0
    )
    shared = replace(
        SharedStripeErrors.of(labels, whole.stripe_place), sigma=np.array([0.03, 0.02, 0.05])
    )
    whole = replace(whole, shared_errors=shared)
    moved = whole.with_families({"placement": scene.poses + 1e-4})
    for chain in (whole, moved):
        thin, block = thinned(chain, chain.n // 8)
        residual = thin.evaluate(thin.parameters.values, {}).residual
        assert np.isfinite(thin.decorrelated(residual)).all()
        size = np.bincount(block)
        for kind in range(3):
            # Covariance of the means that one shared error makes: A b b' A' of the covariance b b' of the points.
            expected = np.bincount(block, shared.shapes[kind]) / size
            assert np.allclose(thin.shared_errors.shapes[kind], expected, atol=1e-12)
            assert np.array_equal(thin.shared_errors.labels[kind][block], shared.labels[kind])


def test_points_far_from_their_stripe_are_named_and_no_others():
    scene = simulated_scanner(np.random.default_rng(20), points=100, steps=4, placements=4)
    pixels = scene.stripes.copy()
    bad = np.arange(7, pixels.shape[1], 41)
    pixels[0, bad] += 4
    chain = BoardStripeChain(
        CAMERA,
        pixels,
        {"placement": scene.placement, "step": scene.step},
        scene.poses,
        scene.planes,
        np.zeros(2),
        1.0,
    )
    assert np.array_equal(np.flatnonzero(wrong_points(chain, chain.at_start)), bad)


def full_scanner():
    angles = np.linspace(-0.08, 0.08, 7)
    made, rng = mirror(2.0), np.random.default_rng(1)
    factor = rng.normal(size=(21, 21)) * 1e-4
    effects = (
        (
            CATALOGUE["plane-bow"]("laser", apex_mm=[-69.0, 0.0, 0.0]),
            np.array([1e-3, 0.05, 0.01, 0.1]),
        ),
        (CATALOGUE["lens-residual"]("camera"), rng.normal(size=10)),
        (CATALOGUE["mirror-encoder-harmonic"]("mirror", order=3), np.array([1e-4, np.pi * 1e-4])),
        (CATALOGUE["camera-thermal-drift"]("camera"), np.array([1e-5, 1e-3, 2e-3])),
    )
    return Scanner(
        CAMERA,
        np.arange(3, 10),
        made.planes(angles),
        made,
        angles,
        effects,
        0.0931,
        factor @ factor.T,
        (114.9, 135.1),
        np.array([0.0, 1.0]),
        {"data_sha256": "0f", "seed": 3},
        rays=1e-4 * rng.normal(size=(15, 36)),
    )


def test_the_file_is_read_back_to_the_bit(tmp_path):
    scanner = full_scanner()
    write_scanner(scanner, tmp_path / "scanner.toml")
    read = read_scanner(tmp_path / "scanner.toml")
    for name in ("steps", "planes", "angles", "covariance", "scan", "rays"):
        assert np.array_equal(getattr(read, name), getattr(scanner, name)), name
    for name in ("axis", "point", "face", "offset", "beam"):
        assert np.array_equal(getattr(read.mirror, name), getattr(scanner.mirror, name)), name
    assert (
        read.camera == scanner.camera
        and read.sigma_px == scanner.sigma_px
        and read.volume == scanner.volume
    )
    assert read.provenance == scanner.provenance
    for (effect, values), (other, others) in zip(read.effects, scanner.effects, strict=True):
        assert (
            type(effect) is type(other)
            and effect.options == other.options
            and np.array_equal(values, others)
        )
    assert scanner_text(read) == scanner_text(scanner)
    assert [path.name for path in tmp_path.iterdir()] == ["scanner.toml"]


def test_a_bare_scanner_is_written_and_read(tmp_path):
    scanner = Scanner(CAMERA, np.array([0]), mirror().planes(np.zeros(1)))
    write_scanner(scanner, tmp_path / "s.toml")
    read = read_scanner(tmp_path / "s.toml")
    assert read.mirror is None and read.covariance is None and read.volume is None
    assert np.array_equal(read.planes, scanner.planes)


BROKEN = [
    (
        r'format = "scanner/1"',
        'format = "scanner/9"',
        "key format: expected \"scanner/1\", found 'scanner/9'",
    ),
    (r"fx_px = 3421.0", "fx_px = -1.0", "focal lengths from 1/100"),
    (
        r"sigma_px = 0.0931",
        'sigma_px = "much"',
        "key light.sigma_px: expected a valid number, found 'much'",
    ),
    (r"sigma_px = 0.0931\n", "", "key light.sigma_px: expected .*, found none"),
    (r"steps = \[\n    3,", "steps = [\n    4,", "expected every step once"),
    (r"steps = \[\n    3,", "steps = [\n", "expected 6, one a step, found 7"),
    (r'covariance = "AAA', 'covariance = "!', "expected 21 x 21 numbers, base64"),
    (
        r"offset_mm = 2.0",
        "offset_mm = 3.0",
        "expected the planes that light.planes holds, found others",
    ),
    (r'effect = "plane-bow"', 'effect = "plane-bend"', "no effect is called 'plane-bend'"),
    (
        r"angle = 0.001",
        "angel = 0.001",
        "effect plane-bow, key parameters: expected angle, angle_distance, angle_shift, angle_shift_square, found angel",
    ),
    (r"\[light\]", "[light", "expected TOML, found a mistake"),
    (r"scan = \[\n    0.0", "scan = [\n    0.5", "key light.scan: expected a unit vector"),
]


@pytest.mark.parametrize(("old", "new", "words"), BROKEN)
def test_a_broken_file_gets_its_sentence(tmp_path, old, new, words):
    scanner = full_scanner()
    covariance = np.zeros((21, 21)) if "AAA" in old else scanner.covariance
    text = scanner_text(replace(scanner, covariance=covariance))
    broken = re.sub(old, lambda _: new, text, count=1)
    assert broken != text
    path = tmp_path / "scanner.toml"
    path.write_text(broken, encoding="utf-8")
    with pytest.raises(InputError, match=words) as problem:
        read_scanner(path)
    assert str(path) in str(problem.value) and "\n" not in str(problem.value).rstrip()


def test_a_file_that_is_not_there_and_a_folder_that_cannot_be_written_to(tmp_path):
    with pytest.raises(InputError, match="expected a readable file"):
        read_scanner(tmp_path / "none.toml")
    with pytest.raises(InputError, match="expected a place to write the scanner to"):
        write_scanner(full_scanner(), tmp_path / "none" / "scanner.toml")


def test_stripes_of_images_know_their_placement_step_and_angle():
    class Found:
        frame, pixels, sigma, scan_axis = (
            np.array([0, 0, 1]),
            np.ones((2, 3)),
            np.full(3, 0.1),
            "rows",
        )
        shape = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])

    made = BoardStripes.of(Found, ["a", "b"], [4, 5], [10.0, 20.0], {"time_s": [1, 2]})
    assert made.placement.tolist() == ["a", "a", "b"] and made.step.tolist() == [4, 4, 5]
    assert np.allclose(np.rad2deg(made.mirror), [10, 10, 20]) and made.covariates[
        "time_s"
    ].tolist() == [1, 1, 2]
    assert joined([made, made.at(np.array([2]))]).shape.tolist() == [[1, 2, 3, 3], [4, 5, 6, 6]]


@pytest.mark.slow
def test_a_real_profiler_on_images_left_out(real):
    """linelaser_circlegrid_zhao: within 0.03 of a circle's pitch, more than 80 % inliers; the authors' plane."""
    import datasets
    from workbench.jobs.sensor.scanner import calibrate

    folder = real("linelaser_circlegrid_zhao")
    run = calibrate(datasets.read("linelaser_circlegrid_zhao"))
    found, pitch = run.calibration, run.camera.calibration.board.square_mm
    assert found.left_out.folds == 12
    assert found.left_out.rms_mm < 0.01 * pitch and found.left_out.share > 0.9
    assert (np.abs(found.left_out.residual_mm) < 0.03 * pitch).mean() > 0.95
    numbers = [
        float(v)
        for v in re.findall(r"<Formular_.>(.*?)</", (folder / "Parameters.xml").read_text())
    ]
    theirs = np.array(numbers[:3]) / np.linalg.norm(numbers[:3])
    assert np.rad2deg(np.arccos(abs(theirs @ found.scanner.planes[:3, 0]))) < 1
