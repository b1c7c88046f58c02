"""A bow of the light planes becomes part of the scanner where the stripes support it, and only there."""

from dataclasses import replace

import numpy as np
import pytest

from plane_scenes import board, board_stripes, simulated_scanner, views
from sensors.scanner.bowed import calibrated_with_bow, misfit_of
from sensors.scanner.calibration import calibrate_scanner
from sensors.state import stripe_direction
from workbench.core.rigid import rotation_matrix


def bent_stripes(truth, curvature):
    """The stripes (2, n) px of a simulated scanner whose light planes are bowed by `curvature` (1/mm), to first order."""
    turns = rotation_matrix(truth.poses[:, 3:])[truth.placement, :, 2]
    heights = (turns * truth.poses[truth.placement, :3]).sum(1)
    rays = truth.camera.rays(truth.stripes)
    points = rays * (heights / (turns.T * rays).sum(0))
    step = truth.camera.rays(truth.stripes + np.array([[1.0], [0.0]]))
    beyond = step * (heights / (turns.T * step).sum(0))
    planes = truth.planes[:3, truth.step]
    along = stripe_direction(truth.planes)[:, truth.step]
    rise = curvature * (along * points).sum(0) ** 2
    bent = truth.stripes.copy()
    bent[0] -= rise / (planes * (beyond - points)).sum(0)
    return bent


def calibrated(curvature):
    """Scanner of twelve boards and three light planes, with flat planes and as a bow is found in the stripes."""
    truth = simulated_scanner(np.random.default_rng(5), placements=12, steps=3)
    stripes = board_stripes(replace(truth, stripes=bent_stripes(truth, curvature)))

    def calibrate(effects):
        size = truth.camera.size
        return calibrate_scanner(
            views(truth), stripes, board(), size, effects=effects, mirror=False
        )

    return calibrate(()), calibrated_with_bow(calibrate)


def test_a_bent_line_is_explained_by_bowed_light_planes():
    flat, made = calibrated(5e-5)
    assert misfit_of(flat).is_relevant and not misfit_of(made).is_relevant
    assert [effect.effect for effect, _ in made.scanner.effects] == ["plane-bow"]
    assert made.left_out.rms_px < 0.9 * flat.left_out.rms_px
    values = made.scanner.effects[0][1]
    assert values[0] == pytest.approx(5e-5, rel=0.1)
    assert any("bowed" in sentence for sentence in made.sentences)


def test_straight_lines_stay_with_flat_light_planes():
    flat, made = calibrated(0.0)
    assert not made.scanner.effects
    assert made.left_out.rms_px == pytest.approx(flat.left_out.rms_px)
