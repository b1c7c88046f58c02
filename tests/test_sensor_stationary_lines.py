"""Scratches and reflections that stay at one place of the image and are taken for the laser line."""

from dataclasses import replace

import numpy as np
import pytest

from plane_scenes import CAMERA, aligned, board, board_stripes, simulated_scanner, views
from sensors.light.stationary_lines import Centres, find_stationary_lines
from sensors.scanner.calibration import calibrate_scanner
from workbench.core.errors import InputError
from workbench.core.rigid import rotation_matrix
from workbench.fitting.verdicts.sensor_verdict import scanner_verdict, scanner_warnings

ACROSS = np.array([1.0, 0.0])
NOISE_PX = 0.05


def simulated(seed: int, steps: int = 10):
    """Eight board poses under the laser, about one centre a row of the image."""
    rng = np.random.default_rng(seed)
    return simulated_scanner(rng, placements=8, steps=steps, points=900)


def scratched(truth, rng, rows=(200.0, 700.0), slope=0.1, share=1.0):
    """The same, where centres between two rows lie on one line of the image in a share of the images."""
    image = truth.placement * len(truth.angles) + truth.step
    taken = rng.uniform(size=image.max() + 1)[image] < share
    u, v = truth.stripes
    taken &= (v > rows[0]) & (v < rows[1])
    line = 600.0 + slope * (v - 500.0) + NOISE_PX * rng.normal(size=len(u))
    return replace(truth, stripes=np.stack([np.where(taken, line, u), v])), taken


def centres(truth) -> Centres:
    """With the depth of the board at each centre, where its ray meets the mean plane of its board."""
    turn, place = rotation_matrix(truth.poses[:, 3:]), truth.poses[:, :3]
    normal = turn[truth.placement, :, 2]
    flat = CAMERA.normalised(truth.stripes)
    ray = np.stack([*flat, np.ones(flat.shape[1])])
    depth = (normal * place[truth.placement]).sum(1) / (normal * ray.T).sum(1)
    image = truth.placement * len(truth.angles) + truth.step
    return Centres(truth.stripes, ACROSS, truth.step, image, depth)


@pytest.mark.parametrize("steps", [1, 10, 60])
def test_laser_lines_alone_are_not_stationary(steps):
    for seed in range(90_100, 90_112):
        lines, displaced = find_stationary_lines(centres(simulated(seed, steps)), CAMERA.fx)
        assert lines == () and not displaced.any()


@pytest.mark.parametrize("slope", [0.0, 0.1, -0.6, 1.5])
@pytest.mark.parametrize("share", [0.2, 1.0])
def test_a_line_that_stays_is_found_where_it_is(slope, share):
    for seed in range(90_200, 90_204):
        truth, taken = scratched(
            simulated(seed), np.random.default_rng(seed), slope=slope, share=share
        )
        lines, displaced = find_stationary_lines(centres(truth), CAMERA.fx)
        assert len(lines) == 1 and displaced[taken].mean() > 0.9
        (u0, u1), (v0, v1) = lines[0].ends
        assert (u1 - u0) / (v1 - v0) == pytest.approx(slope, abs=0.01)
        assert sorted((v0, v1)) == pytest.approx([200, 700], abs=60)


def test_two_lines_are_two():
    rng = np.random.default_rng(6)
    truth, first = scratched(simulated(90_601), rng, rows=(200.0, 500.0))
    truth, second = scratched(truth, rng, rows=(500.0, 800.0), slope=-0.9)
    lines, displaced = find_stationary_lines(centres(truth), CAMERA.fx)
    assert len(lines) == 2 and displaced[first].mean() > 0.9 < displaced[second].mean()


def test_a_single_plane_is_enough():
    truth, _ = scratched(simulated(90_301, 1), np.random.default_rng(1))
    assert len(find_stationary_lines(centres(truth), CAMERA.fx)[0]) == 1


def test_wrong_steps_are_no_stationary_line():
    """Steps that are exchanged contradict each other everywhere, not on one line of the image."""
    truth = simulated(90_401)
    rng = np.random.default_rng(2)
    exchanged = rng.permuted(np.tile(np.arange(10), (8, 1)), axis=1)
    truth = replace(truth, step=exchanged[truth.placement, truth.step])
    assert find_stationary_lines(centres(truth), CAMERA.fx)[0] == ()


def calibrated(truth):
    return calibrate_scanner(views(truth), board_stripes(truth), board(), CAMERA.size)


def plane_error(truth, made) -> float:
    """mm, RMS over the working volume."""
    return aligned(truth, made.camera, made.scanner.planes, steps=made.scanner.steps)[0]


def test_a_short_scratch_is_said_and_does_no_harm():
    clean = simulated(90_501)
    made = calibrated(clean)
    assert made.lines == () and scanner_warnings(made) == []
    truth, taken = scratched(clean, np.random.default_rng(3), rows=(400.0, 500.0))
    found = calibrated(truth)
    (warning,) = scanner_warnings(found)
    assert "lie on one line of the image" in warning and "take the images again" in warning
    assert "DO NOT USE" not in warning and scanner_verdict(found).passed is not False
    assert taken.mean() > 0.05 and plane_error(truth, found) < 2 * plane_error(clean, made) < 0.02


def test_a_scanner_mostly_of_a_scratch_is_refused():
    """Nothing else says so: planes through the camera's centre fit these points within their noise."""
    truth, _ = scratched(simulated(90_502), np.random.default_rng(4), rows=(200.0, 800.0))
    found = calibrated(truth)
    assert any("DO NOT USE" in one and "scratch" in one for one in scanner_warnings(found))
    assert scanner_verdict(found).passed is False


def test_nothing_but_a_scratch_is_an_error_in_one_sentence():
    truth, _ = scratched(simulated(90_503), np.random.default_rng(5), rows=(0.0, 1024.0))
    with pytest.raises(
        InputError, match="moves in the image with the board, found none.*clean optics"
    ):
        calibrated(truth)
