"""Every effect of the scanner, switched on in a rendered image, acts through its port as the chain defines it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

pytest.importorskip("torch")

from sensor_bench import (
    BOARD,
    CAMERA,
    MILD,
    MIRROR,
    POSE,
    board,
    centroids,
    instrument,
    opencv,
    refined,
)
from sensors.effects import CATALOGUE
from sensors.rendering.instrument import Chip, Optics
from sensors.rendering.patterns import Pattern
from sensors.rendering.ports import Causes, Moment, make_causes
from sensors.rendering.render import lamp_light, laser_light, render_scan
from sensors.rendering.surfaces import BoardSurface, true_balls
from sensors.state import SensorState, stripe_direction

COVARIATES = {
    "time_s": 900.0,
    "temperature_c": 30.0,
    "sweep": -1.0,
    "mirror_speed_deg_s": 20.0,
    "exposure_ms": 3.0,
}

# name, place, options, values: large enough to be seen at 1000 px of focal length
SWITCHED = (
    ("lens-residual", "camera", {}, {"z0c2r": 0.5, "z1c2i": 0.4, "z0c1i": 0.3}),
    ("camera-thermal-drift", "camera", {}, {"focal": 1e-4, "x": 0.03, "y": -0.02}),
    ("window-refraction", "camera", {"tilt_deg": [3.0, 5.0]}, {"thickness": 4.0}),
    (
        "window-refraction",
        "camera",
        {"unknown_tilt": True},
        {"thickness": 4.0, "x": 0.5, "yy": 0.2},
    ),
    ("focus-breathing", "camera", {"z0": 100.0}, {"slope": 1e-4}),
    ("plane-bow", "laser", {}, {"curvature": 1e-3}),
    ("plane-bow", "laser", {"apex_mm": [70.0, 0.0, 0.0]}, {"angle": 0.15}),
    ("mirror-wobble", "mirror", {}, {"tilt_cos1": 3e-3, "shift_sin2": 0.5, "shift_cos1": 0.05}),
    ("mirror-encoder-harmonic", "mirror", {"order": 2}, {"cos2": 3e-4, "sin2": 2e-4}),
    ("mirror-hysteresis", "mirror", {}, {"half_gap": 4e-4}),
    ("frame-sync", "time", {}, {"delay": 1e-3}),
    ("range-scale", "sensor", {"z0": 100.0}, {"scale": 4e-3}),
    ("lateral-scale", "sensor", {"axis": "x"}, {"scale_x": 4e-3}),
    ("field-bias", "sensor", {}, {"x": 0.1, "yy": 0.1}),
    ("incidence-bias", "sensor", {}, {"shift": 0.3}),
    ("subsurface-scatter", "sensor", {"everywhere": True}, {"depth": 0.06, "shrink": 0.03}),
    ("board-bow", "artefact", {}, {"xx": 0.2, "yy": -0.1, "xy": 0.2}),
    ("artefact-expansion", "artefact", {}, {"per_unit": 2e-4}),
)
RECORDED = {
    "rolling-shutter",
    "laser-drift",
    "mirror-vibration",
    "recorded-column",
    "board-point-errors",
}
"""Effects that read columns of images.csv: tests/test_diagnosis_sensor_recorded.py."""
OF_THE_LINE = {"blooming", "ghost-line"}
"""Effects on the profile of the laser line: tests/test_sensor_line_profile.py."""
ELSEWHERE = {"ball-position", "ball-radius", "ball-form", "noise-heteroscedastic"}
ELSEWHERE |= RECORDED | OF_THE_LINE


def causes(*rows) -> Causes:
    return make_causes(rows, CAMERA, COVARIATES, 2)


def seen_state(pixels, points, index, made, **known) -> SensorState:
    """What the chain knows of stripe pixels (2, n) of one step."""
    n = pixels.shape[1]
    turn = cv2.Rodrigues(POSE[3:])[0]
    flat = (turn.T @ (points - POSE[:3, None]))[:2]
    share = (flat - BOARD.middle[:2, None]) / BOARD.half_diagonal
    normals = np.tile(-turn[:, 2:], n)
    planes, mirror = np.tile(made.nominal_planes()[:, [index]], n), np.full(n, made.angles[index])
    covariates = {name: np.full(n, value) for name, value in COVARIATES.items()}
    return SensorState(
        CAMERA,
        pixels,
        points,
        planes,
        mirror,
        share,
        normals,
        np.zeros(n, int),
        covariates,
        np.vstack([flat, np.zeros(n)]),
    )


def cut(rays, height=0.0):
    """(3, n) where rays meet the board's plane, lifted by `height` (n,) along its z."""
    normal = cv2.Rodrigues(POSE[3:])[0][:, 2]
    return rays * ((normal @ POSE[:3] + height) / (normal @ rays))


def residual(acting, pixels, index, made):
    """(n,) px from the light plane, by the definition of the ports, written out once more."""
    state = seen_state(pixels, cut(CAMERA.rays(pixels)), index, made)
    rays = CAMERA.rays(pixels - acting.delta("pixel", state)) + acting.delta("ray", state)
    points = cut(rays)
    for _ in range(5):
        points = cut(rays, acting.delta("target", seen_state(pixels, points, index, made))[2])
    state = seen_state(pixels, points, index, made)
    mirror = made.angles[index] + acting.delta("mirror", state)[0]
    light_plane = np.vstack([MIRROR.planes(mirror), np.zeros(len(mirror))]) + acting.delta(
        "plane", state
    )

    def distance(at):
        moved = at + acting.delta("point", seen_state(pixels, at, index, made))
        return (
            (light_plane[:3] * moved).sum(0)
            + light_plane[3]
            + light_plane[4] * (stripe_direction(light_plane[:4]) * moved).sum(0) ** 2
        )

    step = cut(CAMERA.rays(pixels + [[0.5], [0.0]])) - cut(CAMERA.rays(pixels - [[0.5], [0.0]]))
    return distance(points) / (light_plane[:3] * step).sum(0)


@pytest.mark.parametrize("row", SWITCHED, ids=lambda row: "-".join((row[0], *row[2])))
def test_an_effect_acts_through_its_port(row):
    """Centres of rendered stripes fulfil the chain's equation with the effect, and not without it.

    A stripe's light is even, so that its centre is where the light plane's middle is.
    """
    acting, made = causes(row), instrument((0.3,), optics=Optics(0.6, 125.0, 0.0))
    made = replace(made, laser=replace(made.laser, source=None))
    moment = Moment(acting, COVARIATES)
    (light,) = laser_light(made, [board(moment=moment)], [moment])
    rows, centre = centroids(light)
    pixels = np.stack([centre, rows.astype(float)])
    assert len(rows) > 200
    without = residual(Causes(), pixels, 0, made)
    if row[0] != "artefact-expansion":  # in the board's own plane: an even board looks the same
        assert np.abs(without).max() > 0.05
    assert np.abs(residual(acting, pixels, 0, made)).max() < 0.005


def test_every_effect_is_switched_on_somewhere():
    assert {row[0] for row in SWITCHED} | ELSEWHERE == set(CATALOGUE)


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        (
            ("board-bow", "artefact", {}, {"xx": 0.2, "yy": -0.1, "xy": 0.3}),
            lambda x, y, p: p + [0 * x, 0 * x, 0.2 * x * x - 0.1 * y * y + 0.3 * x * y],
        ),
        (
            ("artefact-expansion", "artefact", {}, {"per_unit": 1e-4}),
            lambda x, y, p: p * (1 + 1e-4 * 10),
        ),
    ],
)
def test_a_warped_boards_corners_lie_where_the_warp_puts_them(row, expected):
    """Lamp light: every edge of the print follows the board's points."""
    moment = Moment(causes(row), COVARIATES)
    points = BOARD.points
    share = (points - BOARD.middle[:, None])[:2] / BOARD.half_diagonal
    flat, warped = (opencv(p, POSE, MILD) for p in (points, expected(*share, points)))
    made = replace(instrument(), camera=MILD)
    lights = [
        lamp_light(made, [BoardSurface(Pattern(BOARD), POSE, MILD, m)], 0.7, m)
        for m in (Moment(), moment)
    ]
    before, after = (
        refined(light.cpu().numpy(), start) for light, start in zip(lights, (flat, warped))
    )
    assert np.abs(warped - flat).max() > 0.1
    gap = after - before - warped + flat
    assert np.abs(gap.mean(1)).max() < 0.01
    assert np.sqrt((gap**2).mean()) < 0.02 * np.sqrt(2)  # the finder's own, twice


def test_balls_move_and_grow_as_the_certificate_errs():
    acting = causes(
        ("ball-position", "ball-2", {}, {"x": 0.1, "z": -0.2}),
        ("ball-radius", "ball-1", {}, {"growth": 0.03}),
        ("artefact-expansion", "artefact", {}, {"per_unit": 1e-5}),
    )
    centres, radii = np.array([[0.0, 50], [0, 10], [5, 5]]), np.array([10.0, 12.0])
    moved, grown = true_balls(centres, radii, CAMERA, Moment(acting, COVARIATES))
    np.testing.assert_allclose(
        moved, centres * (1 + 1e-4) + [[0, 0.1], [0, 0], [0, -0.2]], atol=1e-12
    )
    np.testing.assert_allclose(grown, [10.03, 12.0], atol=1e-12)


def test_noise_grows_on_the_stripe_alone():
    acting = causes(
        (
            "noise-heteroscedastic",
            "noise",
            {"covariate": "exposure_ms", "mean": 1.0},
            {"exposure_ms": 0.5},
        )
    )
    made = replace(instrument((0.0,)), chip=Chip(bits=16))
    moment = Moment(acting, COVARIATES)
    (clean,) = laser_light(made, [board()])
    lamp = lamp_light(made, [board()], made.lamp.laser).cpu().numpy()
    gain = 65535 * 0.99 / 10_000
    for moments, factor in (([Moment()], 1.0), ([moment], np.e)):
        gaps = [
            (
                list(render_scan(made, [board()], moments, seed))[0] / gain
                - 655.35 / gain
                - clean
                - lamp
            )
            for seed in range(3)
        ]
        share = np.array(gaps) / np.sqrt(clean + lamp + 144)
        assert share[:, clean > 300].std() == pytest.approx(factor, rel=0.05)
        assert share[:, clean == 0].std() == pytest.approx(1.0, rel=0.05)
