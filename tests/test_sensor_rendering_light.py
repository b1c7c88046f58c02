"""What light does besides geometry: vignetting, blooming, a waist, uneven brightness, gloss, a lamp from the side."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch")

import torch

from sensor_bench import CAMERA, board, instrument
from sensors.rendering import formation
from sensors.rendering.indirect import irradiance
from sensors.rendering.instrument import Chip, Lamp, Optics
from sensors.rendering.render import lamp_light, laser_light, render_board, render_scan
from sensors.rendering.surfaces import BallSurface, Gloss

FACING = np.array([-30.0, -30.0, 140.0, 0, 0, 0])
SHARP = Optics(0.6, 140.0, 0.0)


def test_vignetting_is_the_power_of_the_cosine_of_the_field_angle():
    light = torch.ones((CAMERA.size[1], CAMERA.size[0]))
    made = formation.vignetted(light, CAMERA, 4.0).numpy()
    x, y = (-CAMERA.cx) / CAMERA.fx, (-CAMERA.cy) / CAMERA.fy
    assert made[0, 0] == pytest.approx((1 + x * x + y * y) ** -2, rel=1e-4)
    assert made[round(CAMERA.cy), round(CAMERA.cx)] == pytest.approx(1, abs=1e-5)
    assert formation.vignetted(light, CAMERA, 0.0) is light


def test_a_rendered_board_is_darker_at_its_corners_with_vignetting():
    plain = instrument(optics=SHARP)
    dark = replace(plain, optics=replace(SHARP, vignetting=12.0))
    images = [render_board(one, [board(pose=FACING)]).astype(float) for one in (plain, dark)]
    share = images[1] / images[0]
    assert share[:20, :20].mean() < 0.9 * share[118:138, 150:170].mean()


def test_blooming_spills_charge_along_the_columns_alone():
    chip = Chip(full_well_e=100.0, blooming=0.5, spill_px=2.0)
    light = torch.zeros((41, 9))
    light[20, 4] = 300.0
    made = formation.bloomed(light, chip).numpy()
    gained = made - light.numpy()
    assert gained.sum() == pytest.approx(0.5 * 200.0, rel=1e-4)
    assert gained[:, 4].sum() == pytest.approx(gained.sum()) and gained[20, 4] == 0
    assert gained[22, 4] / gained[21, 4] == pytest.approx(np.exp(-0.5), rel=1e-4)


def widths(light):
    """(n,) px, second moment of the stripe in every lit row."""
    lit = light.sum(1) > 0.5 * light.sum(1).max()
    rows, place = light[lit].astype(float), np.arange(light.shape[1])
    middle = (rows * place).sum(1) / rows.sum(1)
    return np.sqrt((rows * (place - middle[:, None]) ** 2).sum(1) / rows.sum(1))


def test_the_line_is_wider_away_from_its_waist():
    near = instrument((0.0,), optics=Optics(0.3, 140.0, 0.0))
    fixed = replace(near, laser=replace(near.laser, width_mm=0.3, reach_mm=100.0))
    beam = replace(fixed, laser=replace(fixed.laser, rayleigh_mm=80.0))
    source = fixed.light(0)
    lines = [next(laser_light(one, [board(pose=FACING)])) for one in (fixed, beam)]
    spot = np.array([-source[0] * 0, 0.0, 140.0])
    away = np.linalg.norm(spot - source)
    ratio = np.median(widths(lines[1])) / np.median(widths(lines[0]))
    assert ratio == pytest.approx(np.hypot(1, (away - 100.0) / 80.0), rel=0.08)


def test_uneven_brightness_has_its_period_and_moves_no_centre():
    plain = instrument((0.0,), optics=SHARP)
    uneven = replace(plain, laser=replace(plain.laser, uneven=0.5, uneven_deg=2.0))
    one, other = (next(laser_light(i, [board(pose=FACING)])) for i in (plain, uneven))
    lit = one.sum(1) > 0.5 * one.sum(1).max()
    share = other[lit].sum(1) / one[lit].sum(1)
    assert share.max() == pytest.approx(1.5, abs=0.05) and share.min() == pytest.approx(
        0.5, abs=0.05
    )
    place = np.arange(one.shape[1])
    gap = (other[lit] @ place) / other[lit].sum(1) - (one[lit] @ place) / one[lit].sum(1)
    assert np.sqrt((gap**2).mean()) < 0.02


def test_the_highlight_of_a_glossy_ball_is_where_light_is_mirrored_to_the_camera():
    centre, radius = np.array([1.0, 2.0, 136.0]), 12.0
    one = instrument((0.0,), optics=SHARP)
    matt = next(laser_light(one, [BallSurface(centre, radius, 1)]))
    glossy = next(laser_light(one, [BallSurface(centre, radius, 1, gloss=Gloss(2.0, 80.0))]))
    rows = np.flatnonzero(matt.sum(1) > 0.1 * matt.sum(1).max())
    gain = glossy[rows].sum(1) / matt[rows].sum(1)
    source, half = one.light(0), []
    for row in rows:
        column = (matt[row] * np.arange(matt.shape[1])).sum() / matt[row].sum()
        ray = CAMERA.rays(np.array([[column], [float(row)]]))[:, 0]
        ray /= np.linalg.norm(ray)
        along = ray @ centre
        point = ray * (along - np.sqrt(radius**2 - np.linalg.norm(ray * along - centre) ** 2))
        towards = (source - point) / np.linalg.norm(source - point)
        both = (towards - ray) / np.linalg.norm(towards - ray)
        half.append(both @ (point - centre) / radius)
    assert abs(rows[np.argmax(gain)] - rows[np.argmax(half)]) <= 3
    assert gain.max() > 1 + 1.5 * max(half) ** 80 and gain.min() < 1.1


def test_a_lamp_from_the_side_lights_by_its_own_cosine():
    towards = (0.6, 0.0, -0.8)
    made = instrument(optics=SHARP, lamp=Lamp(towards=towards))
    light = lamp_light(made, [board(pose=FACING)], 0.7).cpu().numpy()
    middle = light[100:150, 140:180].mean() / (0.7 * made.chip.full_well_e * 0.8)
    assert middle == pytest.approx(0.8, rel=0.01)


def test_a_patch_gives_the_irradiance_of_a_lambertian_source():
    """Receivers at 5 mm: square to the line, tilted by 60 degrees, and behind their own surface."""
    turned = np.array([[0, 0, -1.0], [np.sqrt(0.75), 0, -0.5], [0, 0, 1.0]]).T
    points = np.tile([[0.0], [0.0], [5.0]], 3)
    patch, normal = np.zeros((3, 1)), np.array([[0.0], [0.0], [1.0]])
    received = irradiance(points, turned, patch, normal, np.array([0.2]))
    assert received == pytest.approx(np.array([1.0, 0.5, 0.0]) * 0.2 / (np.pi * 25.0))


def test_a_lit_ball_throws_light_onto_its_neighbour_and_none_onto_itself():
    """Gain of grey values (16 bits) by inter-reflection, at the first of four steps that together sweep both balls."""
    lit = BallSurface(np.array([0.0, 0.0, 136.0]), 6.0, 1)
    neighbour = BallSurface(np.array([12.5, 0.0, 130.0]), 6.0, 2)
    chip = Chip(read_noise_e=0.0, bits=16)
    plain = instrument((0.0, 0.8, 1.2, 1.6), optics=SHARP, chip=chip)
    mutual = replace(plain, laser=replace(plain.laser, indirect=1.0))

    def gain(surfaces):
        images = [next(render_scan(one, surfaces)).astype(float) for one in (plain, mutual)]
        return images[1] - images[0]

    assert np.abs(gain([lit])).max() < 3
    assert gain([lit, neighbour]).max() > 100


def test_the_edge_of_a_board_out_of_focus_has_no_sharp_line():
    """The steepest step over the edge is that of a Gaussian of the board's blur; a sharp pixel would be steeper."""
    optics = Optics(blur_px=0.6, focus_mm=280.0, defocus_px=4.0)
    made = instrument(optics=optics, lamp=Lamp(background=0.0))
    pose = np.array([45.0, -10.0, FACING[2], 0, 0, 0])
    row = lamp_light(made, [board(pose=pose)], 0.7).cpu().numpy()[120]
    steepest = np.diff(row).max() / row.max()
    sigma = float(optics.sigma(FACING[2]))
    assert sigma > 3.5 and steepest < 1.2 / (sigma * np.sqrt(2 * np.pi))
