"""The renderer agrees with what is computed without it: OpenCV's projection, planes cut by hand, counting statistics."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

pytest.importorskip("torch")

from sensor_bench import (
    BOARD,
    CAMERA,
    MILD,
    PLAIN,
    POSE,
    SOURCE,
    board,
    centroids,
    instrument,
    opencv,
    refined,
)
from sensors.boards.board import Board
from sensors.rendering import formation
from sensors.rendering.instrument import Chip, Lamp, Laser, Optics
from sensors.rendering.patterns import Pattern
from sensors.rendering.render import lamp_light, laser_light, render_board, render_scan
from sensors.rendering.surfaces import BallSurface, BoardSurface, MeshSurface
from sensors.scanner.model import Scanner

# ------------------------------------------------------------------------------------------- boards


@pytest.mark.parametrize("defocus", [0.0, 8.0])
def test_corners_lie_where_opencv_projects_them(defocus):
    """No half-pixel shift: OpenCV's finder against OpenCV's projection."""
    made = replace(instrument(optics=Optics(defocus_px=defocus)), camera=MILD)
    light = lamp_light(made, [BoardSurface(Pattern(BOARD), POSE, MILD)], 0.7).cpu().numpy()
    truth = opencv(BOARD.points, POSE, MILD)
    gap = refined(light, truth) - truth
    assert np.abs(gap.mean(1)).max() < 0.01
    assert np.sqrt((gap**2).mean()) < 0.02  # the finder's own: edges are better, see below


@pytest.mark.parametrize("turn", [0.0, 0.02, 0.2])
def test_edges_lie_where_opencv_projects_them(turn):
    """The sum of light across an edge says to a thousandth of a pixel where it is, whatever the blur."""
    pose = np.array([-10.1, -6.2, 124.0, 0, 0, turn])
    made = replace(instrument(optics=Optics(0.8, 124.0, 0.0)), camera=MILD)
    light = (
        lamp_light(made, [BoardSurface(Pattern(BOARD), pose, MILD)], 0.7)
        .cpu()
        .numpy()
        .astype(float)
    )
    for column in range(6):
        for row in range(3):
            ends = np.array([[column, column], [row + 0.3, row + 0.7], [0, 0]]) * BOARD.square_mm
            (u0, u1), (v0, v1) = opencv(ends, pose, MILD)
            line = round((v0 + v1) / 2)
            edge = u0 + (line - v0) / (v1 - v0) * (u1 - u0)
            assert edge_of(light[line], edge) == pytest.approx(edge, abs=0.004)


def edge_of(values, near):
    """Place of the step in (n,) values: two straight lines that hold as much light as there is."""
    first = round(near) - 15
    place, seen = np.arange(31), values[first : first + 31]
    left, right = (
        np.polyval(np.polyfit(place[part], seen[part], 1), place)
        for part in (slice(9), slice(-9, None))
    )

    def missing(edge):
        share = np.clip(edge - place + 0.5, 0, 1)
        return (share * left + (1 - share) * right - seen).sum()

    return first + brentq(missing, 9, 21)


def test_discs_lie_where_opencv_projects_them():
    """Squarely seen, so that a disc's centre of gravity is its centre; the lens bends it by less than 0.01 px."""
    circles = Board("circles", 5, 4, 5.0)
    pose = np.array([-10.3, -7.1, 125.0, 0, 0, 0.0])
    light = (
        lamp_light(instrument(), [board(Pattern(circles, margin=3), pose)], 0.7)
        .cpu()
        .numpy()
        .astype(float)
    )
    rows, columns = np.mgrid[: light.shape[0], : light.shape[1]]
    for u, v in opencv(circles.points, pose).T:
        near = np.hypot(columns - u, rows - v) < 19
        rim = np.hypot(columns - u, rows - v) > 16
        design = np.stack([rows[near & rim], columns[near & rim], np.ones((near & rim).sum())], 1)
        slope = np.linalg.lstsq(design, light[near & rim], rcond=None)[0]  # the lamp's gradient
        dark = slope[0] * rows[near] + slope[1] * columns[near] + slope[2] - light[near]
        assert (dark * columns[near]).sum() / dark.sum() == pytest.approx(u, abs=0.02)
        assert (dark * rows[near]).sum() / dark.sum() == pytest.approx(v, abs=0.02)


BOARDS = {
    "chessboard": ({"kind": "chessboard", "columns": 6, "rows": 5, "square_mm": 4.0}, {}),
    "charuco": (
        {
            "kind": "charuco",
            "columns": 6,
            "rows": 4,
            "square_mm": 4.5,
            "marker_mm": 3.4,
            "dictionary": "DICT_4X4_50",
        },
        {},
    ),
    "circles": ({"kind": "circles", "columns": 6, "rows": 5, "square_mm": 4.5}, {}),
    "asymmetric": (
        {"kind": "circles", "asymmetric": True, "columns": 4, "rows": 7, "square_mm": 3.5},
        {"radius": 0.4},
    ),
    "negative": (
        {"kind": "circles", "columns": 6, "rows": 5, "square_mm": 4.5},
        {"negative": True},
    ),
}


@pytest.mark.parametrize("name", BOARDS)
def test_the_projects_own_finder_sees_every_kind_of_board(name):
    from sensors.boards.circles import centre_shift
    from sensors.boards.detection import View, detect

    keys, print_keys = BOARDS[name]
    made = Board.of(keys)
    pose = np.array([0, 0, 128.0, 0.15, -0.2, 0.05])
    pose[:3] -= cv2.Rodrigues(pose[3:])[0] @ made.middle
    big = replace(CAMERA, fx=2000.0, fy=1996.0, cx=324.0, cy=250.0, size=(640, 512))
    sharp = replace(instrument(), camera=big)
    image = render_board(sharp, [BoardSurface(Pattern(made, **print_keys), pose, big)])
    view = detect(image, made)
    assert isinstance(view, View), view
    assert len(view.index) == made.count
    truth = big.project(cv2.Rodrigues(pose[3:])[0] @ made.points + pose[:3, None])
    if name in ("chessboard", "charuco"):
        gap = view.pixels - truth[:, view.index]
        assert np.sqrt((gap**2).mean()) < 0.05
    else:
        assert (
            centre_shift
        )  # circles: perspective moves centres of gravity by under a tenth of a pixel here
        gap = view.pixels[:, None, :] - truth[:, :, None]
        assert np.linalg.norm(gap, axis=0).min(0).max() < 0.5


def test_a_charuco_board_is_opencvs():
    """The same print as OpenCV's own image of the board."""
    keys = {
        "kind": "charuco",
        "columns": 6,
        "rows": 4,
        "square_mm": 10.0,
        "marker_mm": 7.5,
        "dictionary": "DICT_4X4_50",
    }
    for legacy in (False, True):
        pattern = Pattern(Board.of(keys | {"legacy": legacy}), white=1.0, dark=0.0)
        made = cv2.aruco.CharucoBoard(
            (7, 5), 10.0, 7.5, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        )
        made.setLegacyPattern(legacy)
        theirs = made.generateImage((7 * 48, 5 * 48)) / 255
        x, y = np.meshgrid(
            (np.arange(7 * 48) + 0.5) / 48 * 10 - 10, (np.arange(5 * 48) + 0.5) / 48 * 10 - 10
        )
        mine = pattern.albedo(x.ravel(), y.ravel(), 0.01).reshape(theirs.shape)
        assert np.mean(np.abs(mine - theirs) > 0.5) < 1e-3


def test_a_pattern_is_the_mean_over_its_square():
    rng = np.random.default_rng(0)
    for pattern in (Pattern(BOARD), Pattern(Board("circles", 5, 4, 5.0))):
        x, y, width = *rng.uniform(-3, 15, (2, 300)), 0.2
        fine = (np.arange(40) + 0.5) / 40 * width - width / 2
        many = pattern.albedo(
            *(
                np.add.outer(p, g).ravel()
                for p, g in ((x, np.tile(fine, 40)), (y, np.repeat(fine, 40)))
            ),
            1e-6,
        )
        # an oblique rim of a circle is taken as if it were square to x or y: 0.1 of the contrast at most
        assert np.abs(many.reshape(300, -1).mean(1) - pattern.albedo(x, y, width)).max() < 0.1 * 0.8


# ------------------------------------------------------------------------------------------ stripes


def test_a_stripe_lies_where_the_planes_cut():
    """Line common to light plane and board, projected by OpenCV; centre of gravity of every row."""
    made = instrument()
    turn = cv2.Rodrigues(POSE[3:])[0]
    flat = np.append(turn[:, 2], -turn[:, 2] @ POSE[:3])
    for plane, light in zip(made.nominal_planes().T, laser_light(made, [board()])):
        along = np.cross(plane[:3], flat[:3])
        start = np.linalg.solve(np.stack([plane[:3], flat[:3], along]), [-plane[3], -flat[3], 0])
        u, v = opencv(start[:, None] + np.outer(along, np.linspace(-150, 150, 40001)))
        order = np.argsort(v)
        rows, centre = centroids(light)
        assert len(rows) > 200
        gap = centre - np.interp(rows, v[order], u[order])
        assert np.abs(gap).max() < 0.002


def test_a_stripe_on_a_bright_edge_is_pulled_to_the_bright_side():
    """What the board's print does to a stripe: the darker half gives less light."""
    printed = board(Pattern(BOARD, white=0.9, dark=0.1))
    (dark,), (plain,) = (list(laser_light(instrument((0.0,)), [b])) for b in (printed, board()))
    assert 0.1 < (dark.sum() / plain.sum()) < 1.1
    rows = np.flatnonzero(plain.sum(1) > 0)
    assert np.ptp(dark[rows].max(1)) > 0.5 * plain.max()


def crossings(light, steps):
    """Pixels (2, n) and steps (n,) of the centres of stripes in light (S, H, W), by parabola through log peaks."""
    found = []
    for step, image in enumerate(light):
        rows, centre = centroids(image, 0.6)
        found.append(np.stack([centre, rows, np.full(len(rows), steps[step])]))
    return np.concatenate(found, 1)[:2], np.concatenate(found, 1)[2].astype(int)


def test_a_balls_cloud_lies_on_the_sphere():
    """A thin sharp light plane, no noise: stripes, reconstructed by the scanner, to under a micrometre."""
    thin = instrument(np.linspace(-1.0, 1.5, 6), optics=Optics(0.7, 125.0, 0.0))
    thin = replace(thin, laser=replace(thin.laser, width_mm=0.03))
    centre = np.array([1.0, 2.0, 136.0])
    pixels, steps = crossings(
        list(laser_light(thin, [BallSurface(centre, 12.0, 1)], oversampling=8)), thin.steps
    )
    points = Scanner(CAMERA, thin.steps, thin.nominal_planes()).reconstruct(pixels, steps)
    square = np.abs(points[1] - centre[1]) < 6  # where a row cuts the stripe squarely enough
    gap = np.linalg.norm(points - centre[:, None], axis=0) - 12.0
    assert square.sum() > 500
    assert np.abs(gap[square]).max() < 1e-3
    assert (
        np.sqrt((gap[square] ** 2).mean()) < 6e-4
    )  # half a micrometre is blur across the stripe's own curve


def test_a_thin_stripe_is_spread_by_the_lens_before_pixels_gather_it():
    """Otherwise its centre of gravity would step from pixel to pixel."""
    thin = instrument((0.0,), optics=Optics(0.8, 125.0, 0.0))
    (light,) = laser_light(
        replace(thin, laser=replace(thin.laser, width_mm=0.02)), [board()], oversampling=6
    )
    rows, centre = centroids(light)
    assert np.abs(centre - np.polyval(np.polyfit(rows, centre, 5), rows)).max() < 0.003


def icosphere(centre, radius):
    import open3d as o3d

    mesh = o3d.geometry.TriangleMesh.create_sphere(radius, 300)
    return MeshSurface(np.asarray(mesh.vertices) + centre, np.asarray(mesh.triangles), 0.7)


def test_a_mesh_of_a_ball_looks_like_the_ball():
    centre, one = np.array([1.0, 2.0, 136.0]), instrument((0.0,))
    (ball,) = laser_light(one, [BallSurface(centre, 12.0, 1, 0.7)])
    (mesh,) = laser_light(one, [icosphere(centre, 12.0)])
    assert np.percentile(np.abs(ball - mesh)[ball > 0], 99) < 0.02 * ball.max()
    (rows, ours), (others, theirs) = centroids(ball), centroids(mesh)
    both, mine, its = np.intersect1d(rows, others, return_indices=True)
    assert len(both) > 0.95 * len(rows)
    assert np.sqrt(np.mean((ours[mine] - theirs[its]) ** 2)) < 0.003


def test_a_ball_casts_its_shadow_on_what_lies_behind():
    """Behind the ball as the laser sees it the board is dark, though the camera sees it."""
    one, far = (
        instrument((0.0,)),
        board(pose=np.array([-30.0, -30.0, 140.0, 0, 0, 0]), pattern=replace(PLAIN, margin=30.0)),
    )
    (free,) = laser_light(one, [far])
    towards = one.light(0)
    rows, centre = centroids(free)
    middle = np.array([[centre[len(rows) // 2]], [rows[len(rows) // 2]]])
    ray = CAMERA.rays(middle)[:, 0]
    spot = ray * 140.0 / ray[2]
    blocker = BallSurface(spot + 0.15 * (towards - spot), 3.0, 1)
    (shaded,) = laser_light(one, [far, blocker])
    row = rows[len(rows) // 2]
    window = slice(int(middle[0, 0]) - 3, int(middle[0, 0]) + 4)
    assert shaded[row, window].max() < 0.02 * free[row, window].max()
    np.testing.assert_allclose(
        shaded[rows[0], window], free[rows[0], window], rtol=1e-3, atol=1e-3 * free.max()
    )


def test_the_light_comes_from_the_sources_image_in_the_mirror():
    """It lies in every light plane, and as far from the axis' far side as the source itself."""
    made = instrument(np.linspace(-4, 4, 5))
    for index, plane in enumerate(made.nominal_planes().T):
        assert plane[:3] @ made.light(index) + plane[3] == pytest.approx(0, abs=1e-9)


def test_defocus_widens_and_keeps_the_light():
    flat = board(pose=np.array([-30.0, -30.0, 124.0, 0, 0, 0]))
    near, far = (
        next(laser_light(instrument((0.0,), optics=Optics(0.6, z, 8.0)), [flat]))
        for z in (124.0, 150.0)
    )
    rows = slice(100, 150)
    assert far[rows].sum() == pytest.approx(near[rows].sum(), rel=2e-3)
    assert far[rows].max() < 0.9 * near[rows].max()
    assert spread(far) - spread(near) == pytest.approx((8 * (1 - 150 / 124)) ** 2, rel=0.02)


def spread(light, row=125):
    """Second moment of the stripe in one row, px^2."""
    weight, place = light[row] / light[row].sum(), np.arange(light.shape[1])
    return (weight * (place - (weight * place).sum()) ** 2).sum()


# ------------------------------------------------------------------------------- chip, noise, speckle


def even_light(level=0.5, **chip):
    """(images of) an even white board without blur of its edges, level times the full well."""
    made = instrument(lamp=Lamp(level, 0.0, 0.0), chip=Chip(**chip))
    return made, [
        board(replace(PLAIN, white=1.0, dark=1.0), np.array([-30.0, -30.0, 125.0, 0, 0, 0]))
    ]


def test_noise_is_that_of_photons_reading_and_rounding():
    """Variance in electrons = count + read noise^2 + a twelfth of a step^2 (EMVA 1288, eq. 10)."""
    made, surfaces = even_light(0.5, full_well_e=8000.0, read_noise_e=20.0, black=0.05, bits=12)
    clean = lamp_light(made, surfaces, 0.5).cpu().numpy()
    gain = 4095 * 0.95 / 8000
    seen = (render_board(made, surfaces, seed=4) / 16 - 4095 * 0.05) / gain
    assert (seen - clean).mean() == pytest.approx(0, abs=5 * np.sqrt(4000 / clean.size))
    share = (seen - clean) ** 2 / (clean + 400 + 1 / (12 * gain**2))
    assert share.mean() == pytest.approx(1, abs=5 * np.sqrt(2 / clean.size))


@pytest.mark.parametrize(("bits", "top"), [(8, 255), (10, 65472), (12, 65520), (16, 65535)])
def test_white_is_full_scale_at_every_depth(bits, top):
    made, surfaces = even_light(3.0, bits=bits)
    image = render_board(made, surfaces)
    assert image.dtype == (np.uint8 if bits == 8 else np.uint16)
    assert image.max() == top
    assert np.mean(image == top) > 0.95


def test_darkness_is_the_black_level():
    made, _ = even_light(0.5, read_noise_e=0.0, black=0.1)
    assert np.unique(render_board(made, [])).tolist() == [26]  # 25.5 rounded to even


def test_how_many_pixels_saturate_is_gauss_integral():
    made, surfaces = even_light(1.0, full_well_e=10_000.0, read_noise_e=0.0, bits=16)
    clean = lamp_light(made, surfaces, 1.0).cpu().numpy()
    expected = norm.sf((10_000 - clean) / np.sqrt(clean)).mean()
    assert 0.02 < expected < 0.98
    assert np.mean(render_board(made, surfaces, seed=1) == 65535) == pytest.approx(
        expected, abs=0.01
    )


def test_speckle_has_its_contrast_and_grain():
    import torch

    light = torch.full((600, 600), 100.0, device=formation.device())
    seen = formation.speckle(light, 0.3, 1.5, formation.generator(1)).cpu().numpy()
    assert seen.mean() == pytest.approx(100, rel=0.01)
    assert seen.std() / seen.mean() == pytest.approx(0.3, rel=0.03)
    field = np.log(seen) - np.log(seen).mean()
    neighbour_correlation = (field[:, 3:] * field[:, :-3]).mean() / field.var()
    assert neighbour_correlation == pytest.approx(
        np.exp(-(3**2) / (4 * 1.5**2)), abs=0.03
    )  # a Gaussian of 1.5 px twice
    assert (seen > 0).all()


def test_brightness_is_lamberts():
    """Peak of a sharp, wide light plane: share of the full well, albedo, cosine, distance."""
    wide = replace(
        instrument((0.0,), optics=Optics(0.3, 125.0, 0.0)),
        laser=Laser(1.0, 0.6, 180.0, SOURCE, 0.0),
    )
    (light,) = laser_light(wide, [board(pose=np.array([-30.0, -30.0, 130.0, 0, 0, 0]))])
    v, u = np.unravel_index(np.argmax(light[100:150]), light[100:150].shape)
    ray = CAMERA.rays(np.array([[float(u)], [v + 100.0]]))[:, 0]
    towards = wide.light(0) - ray * 130 / ray[2]
    length = np.linalg.norm(towards)
    expected = 0.6 * 10_000 * 0.8 * (-towards[2] / length) * 180 / length
    assert light[v + 100, u] == pytest.approx(expected, rel=0.005)


def test_one_seed_one_image():
    made = instrument((0.0,), laser=Laser(0.15, source=SOURCE, contrast=0.2))
    (first,), (again,), (other,) = (
        list(render_scan(made, [board()], seed=seed)) for seed in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.skipif(str(formation.device()) == "cpu", reason="there is no GPU here")
def test_a_gpu_makes_the_same_light(monkeypatch):
    import torch

    (there,) = laser_light(instrument((0.0,)), [board()])
    monkeypatch.setattr(formation, "device", lambda: torch.device("cpu"))
    (here,) = laser_light(instrument((0.0,)), [board()])
    np.testing.assert_allclose(there, here, rtol=1e-4, atol=1e-4 * here.max())
