"""Stripe chain, light planes and mirror: gradients, geometry against a forward calculation, and starts."""

import numpy as np
import pytest

from plane_scenes import CAMERA, HALF_DIAGONAL, MIDDLE, bow, mirror, simulated_scanner
from sensors.camera.model import Camera
from sensors.light.board_chain import BoardStripeChain
from sensors.light.mirror import NAMES, MovedMirror, on_one_branch, start_mirror
from sensors.light.planes import in_tilts, moved, moved_rows, plane_through
from workbench.core.errors import InputError


def chain_of(truth, with_mirror=False, camera=CAMERA):
    return BoardStripeChain(
        camera,
        truth.stripes,
        {"placement": truth.placement, "step": truth.step},
        truth.poses,
        truth.planes,
        MIDDLE,
        HALF_DIAGONAL,
        mirror=truth.mirror if with_mirror else None,
        angles=truth.angles,
    )


@pytest.fixture(scope="module")
def small():
    return simulated_scanner(np.random.default_rng(1), placements=3, steps=4, points=12)


PORTS = {
    "pixel": (2, 0.5),
    "ray": (3, 1e-3),
    "point": (3, 0.02),
    "target": (3, 0.05),
    "plane": (5, 1e-4),
    "mirror": (1, 1e-3),
}


def moved_ports(rng, n, bent, with_mirror):
    return {
        port: (np.arange(width), bent * size * rng.normal(size=(width, n)))
        for port, (width, size) in PORTS.items()
        if with_mirror or port != "mirror"
    }


@pytest.mark.parametrize("bent", [0, 1])
@pytest.mark.parametrize("with_mirror", [False, True])
def test_rows_are_the_derivatives_for_every_port(small, bent, with_mirror):
    chain = chain_of(small, with_mirror)
    values, deltas = (
        chain.parameters.values,
        moved_ports(np.random.default_rng(2), chain.n, bent, with_mirror),
    )
    here = chain.evaluate(values, deltas)
    for port, (port_indices, change) in deltas.items():
        for port_index in port_indices:
            step = 1e-4 * PORTS[port][1]
            sides = []
            for sign in (1, -1):
                other = change.copy()
                other[port_index] += sign * step
                sides.append(
                    chain.evaluate(values, {**deltas, port: (port_indices, other)}).residual
                )
            expected = (sides[0] - sides[1]) / (2 * step)
            found = here.rows(port, np.array([port_index]))[0]
            limit = 1e-5 * abs(expected).max() + 1e-7
            assert abs(found - expected).max() <= limit, (port, port_index)


@pytest.mark.parametrize("bent", [0, 1])
@pytest.mark.parametrize("with_mirror", [False, True])
def test_rows_are_the_derivatives_for_camera_mirror_poses_and_planes(small, bent, with_mirror):
    camera = Camera.of([*CAMERA.values, 0.2, 0.1, 0.1], CAMERA.size)
    rng = np.random.default_rng(3)
    chain = chain_of(small, with_mirror, camera)
    change = bent * 1e-3 * rng.normal(size=(4, 3))
    chain = chain.with_families({"step": change})
    deltas = moved_ports(rng, chain.n, bent, with_mirror)
    values = chain.parameters.values + bent * 1e-2 * chain.parameters.typical
    here = chain.evaluate(values, deltas)
    own = here.own_rows(np.arange(len(values)))
    for k, size in enumerate(1e-4 * chain.parameters.typical):
        other = np.eye(len(values))[k] * size
        expected = (
            chain.evaluate(values + other, deltas).residual
            - chain.evaluate(values - other, deltas).residual
        ) / (2 * size)
        assert abs(own[k] - expected).max() <= 2e-5 * abs(expected).max() + 1e-7, (
            chain.parameters.keys[k]
        )
    for name, start, size in (("placement", chain.poses, 1e-5), ("step", change, 1e-6)):
        if with_mirror and name == "step":
            continue
        rows = here.family_rows(name)
        for k in range(start.shape[1]):
            other = np.eye(start.shape[1])[k] * size
            sides = [
                chain.with_families(
                    {"placement": chain.poses, "step": change, name: start + sign * other}
                )
                .evaluate(values, deltas)
                .residual
                for sign in (1, -1)
            ]
            expected = (sides[0] - sides[1]) / (2 * size)
            assert abs(rows[k] - expected).max() <= 2e-5 * abs(expected).max() + 1e-7, (name, k)


def test_a_stripe_made_forwards_has_no_residual_backwards():
    truth = simulated_scanner(
        np.random.default_rng(4), placements=3, steps=5, points=40, stripe=0.0
    )
    chain = chain_of(truth)
    on_board = chain.state.target
    assert abs(chain.evaluate(chain.parameters.values, {}).residual).max() > 0.05  # the bow is seen
    height = np.zeros((3, chain.n))
    for _ in range(8):
        height[2] = bow(*on_board[:2])
        here = chain.evaluate(chain.parameters.values, {"target": (np.arange(3), height)})
        on_board = here.on_board
    assert abs(here.residual).max() < 1e-8


def test_one_pixel_along_the_scan_line_is_one_pixel_of_residual(small):
    chain = chain_of(small)
    shifted = BoardStripeChain(
        chain.camera,
        chain.pixels + np.array([[0.3], [0.0]]),
        chain.labels,
        chain.poses,
        chain.planes,
        MIDDLE,
        HALF_DIAGONAL,
        angles=chain.angles,
    )
    change = (
        shifted.evaluate(shifted.parameters.values, {}).residual
        - chain.evaluate(chain.parameters.values, {}).residual
    )
    assert abs(abs(change) - 0.3).max() < 1e-3


def test_an_effect_of_the_mirror_on_free_planes_gets_its_sentence(small):
    chain = chain_of(small)
    with pytest.raises(InputError, match="expected the mirror's angles"):
        chain.evaluate(chain.parameters.values, {"mirror": (np.array([0]), np.ones((1, chain.n)))})


def test_planes_of_the_mirror_are_the_reflections_of_its_light_plane():
    made, angles = mirror(offset=3.0), np.linspace(-0.2, 0.2, 5)
    planes, normals = made.planes(angles), made.normals(angles)
    rng = np.random.default_rng(5)
    on_plane = rng.normal(size=(3, 20))
    on_plane -= np.outer(made.beam[:3], made.beam[:3] @ on_plane + made.beam[3])
    for k in range(5):
        # the face: m.(X - a) = e, and a point of the light plane mirrored in it
        height = normals[:, k] @ (on_plane - made.point[:, None]) - made.offset
        image = on_plane - 2 * np.outer(normals[:, k], height)
        assert abs(planes[:3, k] @ image + planes[3, k]).max() < 1e-11


def test_mirror_rows_are_the_derivatives():
    made, angles = mirror(offset=3.0), np.linspace(-0.2, 0.2, 7)
    change = np.array([0.02, -0.01, 0.5, -0.3, 0.01, 0.02, 0.4, 1.03, -0.5, 0.03])
    rows = MovedMirror(made, change).rows(angles)
    for k, name in enumerate(NAMES):
        other = 1e-6 * np.eye(10)[k]
        expected = (
            MovedMirror(made, change + other).planes(angles)
            - MovedMirror(made, change - other).planes(angles)
        ) / 2e-6
        assert abs(rows[k] - expected).max() < 1e-7, name


def test_the_start_of_a_mirror_makes_its_planes_and_finds_unknown_steps():
    truth, angles = mirror(), np.linspace(-0.09, 0.08, 30)
    planes = truth.planes(angles)
    for by_step, commanded in ((False, angles), (True, np.arange(3.0, 33.0))):
        found, gain = start_mirror(planes, commanded, by_step)
        made = found.planes(commanded * gain if by_step else commanded)
        assert abs(made - planes).max() < 1e-9
        assert gain == pytest.approx((0.17 / 29) if by_step else 1.0, rel=1e-9)


def test_commanded_angles_on_two_branches_are_brought_to_one():
    """A quarter turn leaves the planes; angles of the light, twice those of the mirror, span as much and stay."""
    angles = np.linspace(-0.6, 0.2, 12)
    planes = mirror().planes(angles)
    branches = angles + np.where(np.arange(12) < 4, np.pi / 2, 0.0)
    assert on_one_branch(planes, branches) == pytest.approx(angles, abs=1e-12)
    assert np.array_equal(on_one_branch(planes, angles), angles)
    assert np.array_equal(on_one_branch(planes, 2 * angles), 2 * angles)


@pytest.mark.parametrize("by_step", [False, True])
def test_the_start_of_a_mirror_over_a_narrow_sweep_stands_noise_of_its_planes(by_step):
    """Planes that are tilted along the stripe from image to image, as a rolling shutter tilts them."""
    truth, angles = mirror(), np.linspace(-0.028, 0.028, 10)
    exact = truth.planes(angles)
    tilts = 1.5e-3 * np.random.default_rng(6).normal(size=10)
    planes = moved(exact, np.stack([tilts, 0 * tilts, 0 * tilts], 1))
    commanded = np.arange(10.0) if by_step else angles
    found, gain = start_mirror(planes, commanded, by_step)
    assert abs(found.axis @ truth.axis) > np.cos(np.deg2rad(8))
    assert gain == pytest.approx(0.056 / 9 if by_step else 1.0, rel=0.03)
    made = found.planes(commanded * gain if by_step else commanded)
    made = made * np.sign((made[:3] * exact[:3]).sum(0))
    assert abs(made[:3] - exact[:3]).max() < 6e-3


def test_planes_move_by_tilts_and_offset():
    planes = mirror().planes(np.linspace(-0.1, 0.1, 3))
    change = np.array([[0.01, -0.02, 0.3]] * 3)
    there = moved(planes, change)
    assert np.allclose(np.linalg.norm(there[:3], axis=0), 1, atol=1e-14)
    assert np.allclose(np.arccos((there[:3] * planes[:3]).sum(0)), np.arctan(np.hypot(0.01, 0.02)))
    rows = moved_rows(planes, change)
    for k in range(3):
        other = 1e-6 * np.eye(3)[k]
        assert np.allclose(
            rows[k],
            (moved(planes, change + other) - moved(planes, change - other)) / 2e-6,
            atol=1e-8,
        )
    assert np.allclose(
        in_tilts(planes, moved_rows(planes, 0 * change)), np.eye(3)[:, :, None], atol=1e-12
    )


def test_a_plane_goes_through_its_points_and_not_through_blunders():
    rng = np.random.default_rng(6)
    plane = np.array([0.6, 0.0, 0.8, 30.0])
    points = rng.uniform(-20, 20, (3, 400))
    points -= np.outer(plane[:3], plane[:3] @ points + plane[3]) + np.outer(
        plane[:3], 0.002 * rng.normal(size=400)
    )
    points[:, :60] += rng.uniform(1, 5, (3, 60))
    found, spread = plane_through(points)
    assert abs(found[:3] @ plane[:3]) > 1 - 1e-7
    assert spread[2] < 0.003 < 1 < spread[1]
