"""The errors of flange poses are stated at the flange's origin; a scale of the board is kept by a test only."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hand_eye_scenes import CAMERA, board, images
from sensors.hand_eye.adjust import Variances, adjust
from sensors.hand_eye.images import _chain, _is_reduced, _pivot
from sensors.hand_eye.start import board_poses, start_from_boards
from sensors.hand_eye.uncertainty.flange_variance import flange_variance
from workbench.core.rigid import transform
from workbench.fitting.verdicts.hand_eye_verdict import flange_error_words


def variances_of(seed, shift, spin, count=25, directions=(1.0, 1.0, 1.0)):
    """Of simulated views with independent errors of position (mm) and rotation (rad) of the flange, by adjustment.

    directions: factors of the position errors along x, y and z.
    """
    views, flange = images(seed, shift=0, spin=0, count=count, noise=0.02)
    random = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(random.normal(0, 1, (count, 3)) * spin).as_matrix()
    moved = flange[:, :3, 3] + shift * random.normal(0, 1, (count, 3)) * directions
    flange = transform(turns @ flange[:, :3, :3], moved)
    points = board().points
    chain = _chain(views, points, CAMERA, flange, "in-hand", None)
    seen = board_poses(chain.board, chain.pixels, chain.pose, CAMERA)
    start, _ = start_from_boards(flange, seen, points, "in-hand")
    chain = replace(chain, pivot=_pivot("board", chain, start, points))
    parameters = replace(chain.parameters, values=np.append(start, 0.0)).free("*")
    fit = adjust(chain, parameters.fix("target.scale"), Variances(0.02, np.array([0.1, 3e-4])))
    return fit, flange_variance(fit, flange[:, :3, 3])


@pytest.mark.parametrize(("shift", "spin"), [(0.05, 3e-4), (0.2, 1e-4)])
def test_both_components_are_those_of_the_flange(shift, spin):
    fit, found = variances_of(2, shift, spin)
    assert abs(found.spread[0] - shift) < 3 * found.std[0] < shift
    assert abs(found.spread[1] - spin) < 3 * found.std[1] < spin


def test_the_uncertainty_holds_for_errors_along_one_direction():
    """As many independent errors as poses, a third of those of errors that are alike in all directions."""
    found = [variances_of(seed, 0.1, 3e-4, 20, (0.1, 0.1, 1.73))[1] for seed in range(100, 140)]
    scatter = np.std([one.spread[0] for one in found])
    stated = np.sqrt(np.mean([one.std[0] ** 2 for one in found]))
    assert 0.75 < scatter / stated < 1.25


def test_rotation_errors_alone_are_no_position_error():
    """At the board, which is 0.3 m away, they are one."""
    fit, found = variances_of(3, 0.0, 5e-4)
    assert fit.variances.spread[0] > 0.05 and found.spread[0] == 0
    assert found.spread[1] == pytest.approx(5e-4, rel=0.3)
    assert np.linalg.norm(found.errors[:, :3], axis=1).max() < 0.01


def test_words_of_the_components():
    both = {"flange_position_mm": 0.1, "flange_position_std_mm": 0.01, "flange_rotation_deg": 0.01}
    assert "0.17 ± 0.017 mm (3-D position of the flange's origin)" in flange_error_words(
        {"position_mm": 0.3, **both}
    )
    none = {"position_mm": 0.3, **both, "flange_position_mm": 0.0}
    assert "no position error that is distinguishable from zero (less than" in flange_error_words(
        none
    )
    assert "not separable" in flange_error_words({**none, "flange_rotation_deg": 0.0})


def test_a_scale_that_chance_explains_is_not_kept():
    before = np.array([0.3, 0.1, 0.2, 0.05, 0.4, 0.1, 0.2, 0.15, np.nan, 0.1, 0.08])
    chance = before - 0.06 * np.array([1, -1, 0.5, -0.5, 1, -0.7, 0.4, -0.3, 1, -0.6, 0.5])
    assert np.nansum(before - chance) > 0
    assert not _is_reduced(before, chance, is_certain=False)
    assert _is_reduced(before, chance, is_certain=True)
    assert _is_reduced(before, 0.8 * before, is_certain=False)
    assert not _is_reduced(before, 1.1 * before, is_certain=True)
