"""Every effect of the scanner keeps the contract: exact null, right derivative, components, names, sentences."""

import subprocess
import sys
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from conftest import ROOT
from effect_cases import SCANNER_ADDITIONS, VOCABULARY
from sensors.camera.model import Camera
from sensors.effects import CATALOGUE
from sensors.state import SensorState, stripe_direction
from workbench.core.effect import Effect, make_effects, numeric_derivative
from workbench.core.errors import InputError
from workbench.core.parameters import Parameters

PORT_SIZES = {"pixel": 2, "ray": 3, "mirror": 1, "plane": 5, "point": 3, "target": 3, "noise": 1}
CAMERA = Camera(900.0, 905.0, 310.0, 250.0, (-0.16, 0.2, 0.0005, -0.0004, 0.0), (640, 512))
CASES = (
    ("lens-residual", "camera", {}),
    ("lens-residual", "camera", {"degree": 4}),
    ("camera-thermal-drift", "camera", {}),
    ("camera-thermal-drift", "camera", {"time_constant_s": 120.0, "start_s": 7.0}),
    ("window-refraction", "camera", {"index": 1.52, "tilt_deg": [2.0, -1.0]}),
    ("window-refraction", "camera", {"unknown_tilt": True}),
    ("focus-breathing", "camera", {"z0": 120.0}),
    ("blooming", "camera", {}),
    ("blooming", "camera", {"along": "columns"}),
    ("ghost-line", "laser", {}),
    ("ghost-line", "laser", {"offset_mm": -0.4, "angle_deg": 0.5, "width_mm": 0.1}),
    ("plane-bow", "laser", {}),
    ("plane-bow", "laser", {"apex_mm": [70.0, 0.0, -20.0]}),
    ("plane-bow", "laser", {"depth_mm": 120.0}),
    ("mirror-wobble", "mirror", {}),
    ("mirror-encoder-harmonic", "mirror", {"order": 3}),
    ("mirror-hysteresis", "mirror", {}),
    ("frame-sync", "time", {}),
    ("rolling-shutter", "time", {}),
    ("laser-drift", "laser", {}),
    ("laser-drift", "laser", {"time_constant_s": 120.0}),
    ("laser-drift", "laser", {"apex_mm": [70.0, 0.0, -20.0], "axis": [0.0, 0.6, 0.8]}),
    ("mirror-vibration", "mirror", {"angular_frequency": 0.3}),
    ("recorded-column", "mirror", {"column": "exposure_ms", "spread": 0.5}),
    ("recorded-column", "laser", {"column": "exposure_ms"}),
    ("board-point-errors", "artefact", {"line": "row", "at_mm": 20.0}),
    ("range-scale", "sensor", {"z0": 125.0}),
    ("lateral-scale", "sensor", {}),
    ("lateral-scale", "sensor", {"axis": "y"}),
    ("field-bias", "sensor", {}),
    ("incidence-bias", "sensor", {}),
    ("subsurface-scatter", "sensor", {}),
    ("subsurface-scatter", "sensor", {"everywhere": True}),
    ("board-bow", "artefact", {}),
    ("ball-position", "ball-2", {}),
    ("ball-radius", "ball-2", {}),
    ("ball-radius", "artefact", {}),
    ("ball-form", "ball-2", {}),
    ("ball-form", "ball-2", {"degree": 3}),
    ("artefact-expansion", "artefact", {}),
    ("artefact-expansion", "artefact", {"time_constant_s": 120.0}),
    (
        "noise-heteroscedastic",
        "noise",
        {"covariate": "incidence_deg", "mean": 30.0, "spread": 20.0},
    ),
    ("noise-heteroscedastic", "noise", {"covariate": "exposure_ms", "mean": 2.0}),
)
NEEDS = {
    "blooming": "line_brightness",
    "mirror-hysteresis": "sweep",
    "frame-sync": "mirror_speed_deg_s",
    "rolling-shutter": "mirror_speed_deg_s",
    "laser-drift": "time_s",
    "mirror-vibration": "time_s",
    "recorded-column": "exposure_ms",
    "noise-heteroscedastic": "exposure_ms",
}
EVERY = pytest.mark.parametrize(
    "case", CASES, ids=lambda case: "-".join(str(part) for part in (case[0], *case[2]))
)


@dataclass
class Bench:
    """What an effect asks of a chain: how its ports are numbered, and its state."""

    state: SensorState

    def port_indices(self, port, where, components):
        return components or tuple(range(PORT_SIZES[port]))

    def numbers(self, place):
        return (1, 2, 3)


def observations(n=60, seed=5) -> SensorState:
    """Random stripes on balls 1 to 3 and on the board."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform((0, 0), (639, 511), (n, 2)).T
    points = CAMERA.rays(pixels) * rng.uniform(110, 140, n)
    normals = rng.normal(size=(3, n)) * 0.3 - np.array([[0], [0], [1]])
    normals /= np.linalg.norm(normals, axis=0)
    tilts = rng.normal(size=(3, n)) * 0.1 + np.array([[0.9], [0], [0.4]])
    tilts /= np.linalg.norm(tilts, axis=0)
    planes = np.vstack([tilts, -(tilts * points).sum(0)])
    covariates = {
        "sweep": rng.choice([-1.0, 1.0], n),
        "mirror_speed_deg_s": rng.normal(0, 3, n),
        "time_s": np.arange(n) * 1.0,
        "exposure_ms": rng.uniform(1, 3, n),
        "temperature_c": rng.uniform(18, 30, n),
        "line_brightness": rng.normal(0, 0.5, n),
        "line_width": rng.normal(0, 0.1, n),
    }
    board = rng.uniform(-0.7, 0.7, (2, n))
    return SensorState(
        CAMERA,
        pixels,
        points,
        planes,
        rng.uniform(-0.2, 0.2, n),
        board,
        normals,
        rng.integers(0, 4, n),
        covariates,
        10.0 * rng.integers(0, 9, (3, n)),
    )


def corners(n=10) -> SensorState:
    """Board corners: no light plane, no mirror, no ball."""
    state = observations(n)
    return replace(
        state, planes=np.full((4, n), np.nan), mirror=np.full(n, np.nan), ball=np.zeros(n, int)
    )


def made(case, state=None) -> tuple[Effect, Bench, int]:
    bench = Bench(state or observations())
    (effect,) = make_effects(CATALOGUE, [case])
    return effect, bench, len(effect.parameters(bench))


def test_every_effect_of_the_catalogue_is_in_the_table():
    assert {name for name, _, _ in CASES} == set(CATALOGUE)


@EVERY
def test_its_name_is_in_the_vocabulary_and_says_where_it_is_from(case):
    kind = CATALOGUE[case[0]]
    assert kind.effect == case[0] in VOCABULARY | SCANNER_ADDITIONS
    assert kind.port in PORT_SIZES
    assert kind.__doc__.strip() and kind.equation and kind.source


@EVERY
def test_parameters_carry_key_unit_null_size_and_label(case):
    effect, bench, count = made(case)
    table = effect.parameters(bench)
    assert count == len(Parameters.of(table)) > 0  # no key twice
    for parameter in table:
        assert parameter.key.split(".")[:2] == [case[1], case[0]]
        assert parameter.unit and parameter.label.strip()
        assert parameter.null == 0 and parameter.prior >= parameter.typical > 0


@EVERY
def test_port_indices_lie_in_the_port_and_match_the_shapes(case):
    effect, bench, count = made(case)
    port_indices = effect.port_indices(bench)
    assert len(set(port_indices)) == len(port_indices) > 0
    assert set(port_indices) <= set(range(PORT_SIZES[effect.port]))
    assert effect.delta(np.ones(count), bench.state).shape == (len(port_indices), bench.state.n)
    assert effect.derivative(np.ones(count), bench.state).shape == (
        count,
        len(port_indices),
        bench.state.n,
    )


@EVERY
def test_it_is_exactly_absent_at_null_and_acts_beyond(case):
    effect, bench, count = made(case)
    assert not effect.delta(np.zeros(count), bench.state).any()
    for one in np.eye(count):
        assert np.abs(effect.delta(one, bench.state)).max() > 0


@EVERY
@pytest.mark.parametrize("size", [0.0, 1.0, -2.0])
def test_its_derivative_is_that_of_its_delta(case, size):
    effect, bench, count = made(case)
    sizes = np.array([p.typical for p in effect.parameters(bench)])
    found = effect.derivative(size * sizes, bench.state)
    expected = numeric_derivative(
        lambda p: effect.delta(p, bench.state), size * sizes, 1e-3 * sizes
    )
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())


@EVERY
def test_what_an_observation_lacks_does_not_make_it_undefined(case):
    """Corners have no plane, and the joint adjustment puts every effect to every chain."""
    effect, bench, count = made(case, corners())
    assert np.isfinite(effect.derivative(np.ones(count), bench.state)).all()
    if effect.port in ("plane", "mirror") and not effect.needs and case[0] != "plane-bow":
        assert not effect.delta(np.ones(count), bench.state).any()


@EVERY
def test_a_covariate_that_it_needs_is_named_where_it_is_missing(case):
    effect, bench, count = made(case, replace(observations(), covariates={}))
    needs = NEEDS.get(case[0]) if effect.needs else None
    if case[0] in ("camera-thermal-drift", "artefact-expansion"):
        needs = "time_s" if effect.needs else "temperature_c"
    if needs is None:
        assert np.isfinite(effect.delta(np.ones(count), bench.state)).all()
        return
    with pytest.raises(InputError, match=f"column {needs}"):
        effect.delta(np.ones(count), bench.state)


@EVERY
def test_a_wrong_place_is_a_sentence(case):
    with pytest.raises(InputError, match=f"effect '{case[0]}' cannot sit at 'joint-1'"):
        make_effects(CATALOGUE, [(case[0], "joint-1", case[2])])


def test_a_ball_that_is_not_there_is_a_sentence():
    effect, bench, _ = made(("ball-position", "ball-2", {}))
    (absent,) = make_effects(CATALOGUE, [("ball-position", "ball-9", {})])
    with pytest.raises(InputError, match="one of 1, 2, 3, found 'ball-9'"):
        absent.parameters(bench)


@pytest.mark.parametrize(
    "case",
    [
        ("plane-bow", "laser", {"apex_mm": [1.0]}),
        ("window-refraction", "camera", {"index": 0.5}),
        ("lens-residual", "camera", {"degree": 9}),
        ("mirror-encoder-harmonic", "mirror", {"order": 0}),
    ],
)
def test_an_impossible_option_is_a_sentence(case):
    with pytest.raises(
        InputError, match=f"effect '{case[0]}', option {next(iter(case[2]))}: expected"
    ):
        make_effects(CATALOGUE, [case])


def test_the_page_of_effects_lists_them():
    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    scanner = page[page.index("sensors/effects/") :]
    assert all(f"| `{name}` | {kind.effect} | " in scanner for name, kind in CATALOGUE.items())
    check = [sys.executable, str(ROOT / "tools" / "effects_page.py"), "--check"]
    assert subprocess.run(check, cwd=ROOT, env={"PYTHONPATH": str(ROOT)}).returncode == 0


def circle_state(n=4000):
    """Pixels even over the circle around a square image's middle; the circle is where the field is 1."""
    rng = np.random.default_rng(1)
    radius, angle = np.sqrt(rng.uniform(0, 1, n)), rng.uniform(0, 2 * np.pi, n)
    camera = replace(CAMERA, size=(1001, 1001))
    half = np.hypot(1001, 1001) / 2
    pixels = 500 + half * np.stack([radius * np.cos(angle), radius * np.sin(angle)])
    return replace(observations(n), camera=camera, pixels=pixels), pixels - 500, half


def test_the_lens_residual_holds_nothing_that_brown_and_a_pose_make():
    """Orthogonal to shifts, scale, turn, aspect, tilt, decentring and k1, over the circle."""
    state, (x, y), half = circle_state(200_000)
    x, y = x / half, y / half
    r2, one, none = x * x + y * y, np.ones_like(x), np.zeros_like(x)
    taken = [
        (one, none),
        (none, one),
        (x, none),
        (none, y),
        (-y, x),
        (x * x, x * y),
        (x * y, y * y),
        (2 * x * y, r2 + 2 * y * y),
        (r2 + 2 * x * x, 2 * x * y),
        (x * r2, y * r2),
    ]
    taken = np.array(taken).reshape(len(taken), -1)
    (effect,) = make_effects(CATALOGUE, [("lens-residual", "camera", {"degree": 4})])
    mine = effect.basis(state).reshape(len(effect.terms), -1)
    cosine = (mine @ taken.T) / np.outer(
        np.linalg.norm(mine, axis=1), np.linalg.norm(taken, axis=1)
    )
    assert np.abs(cosine).max() < 0.01  # what 200,000 random pixels leave
    assert np.linalg.cond(mine @ mine.T) < 100


def test_a_window_moves_the_ray_as_snells_law_does():
    """Traced surface by surface: into the glass at one face, out at the other."""
    state, index, thickness = observations(), 1.5, 3.0
    (effect,) = make_effects(CATALOGUE, [("window-refraction", "camera", {"index": index})])
    rays = state.rays
    sine = np.hypot(*rays[:2])
    inside = np.arcsin(sine / index)
    depth = 20.0  # where the window begins does not matter
    radial = (
        depth * sine / rays[2]
        + thickness * np.tan(inside)
        + (state.points[2] - depth - thickness) * sine / rays[2]
    )
    reached = np.stack([rays[0] / sine * radial, rays[1] / sine * radial, state.points[2]])
    moved = rays + effect.delta(np.array([thickness]), state)
    flat = moved[:2] / moved[2] * state.points[2]
    np.testing.assert_allclose(
        flat, reached[:2], atol=1e-3
    )  # of 0.4 mm: first order in thickness over range


def test_a_bowed_light_plane_departs_with_the_square_of_the_place_along_the_stripe():
    state = observations()
    (flat,) = make_effects(CATALOGUE, [("plane-bow", "laser", {})])
    assert flat.delta(np.array([1e-4]), state) == pytest.approx(np.full((1, state.n), 1e-4))
    along = stripe_direction(state.planes)
    np.testing.assert_allclose((along * state.planes[:3]).sum(0), 0, atol=1e-15)
    np.testing.assert_allclose(state.stripe_place, (along * state.points).sum(0))


def test_a_cone_is_what_the_bow_with_an_apex_makes_of_the_plane():
    """Points of the exact cone x = tan(a) |(y, z)| from the camera's place, tangent plane along y = 0."""
    angle, place = 0.01, np.linspace(-20, 20, 41)
    points = np.stack([np.tan(angle) * np.hypot(place, 150), place, np.full(41, 150.0)])
    normal = np.array([np.cos(angle), 0, -np.sin(angle)])
    state = replace(
        observations(41), points=points, planes=np.tile(np.append(normal, 0.0)[:, None], 41)
    )
    (effect,) = make_effects(CATALOGUE, [("plane-bow", "laser", {"apex_mm": [0.0, 0.0, 0.0]})])
    bend = effect.delta(np.array([-angle, 0, 0, 0]), state)[0]
    np.testing.assert_allclose(normal @ points + bend, 0, atol=2e-4)
    assert np.abs(normal @ points).max() > 0.01


def test_the_apex_of_a_cone_stands_behind_the_mirror_and_displaced_along_its_axis():
    """f = a (s - h)^2 / (2 (r + d)) about the mirror's axis, whose parameters are a, a d, a h and a h^2."""
    angle, distance, shift = 0.03, 6.0, 8.0
    axis = np.array([0.2, 0.9, -0.1]) / np.linalg.norm([0.2, 0.9, -0.1])
    state = observations(40)
    options = {"apex_mm": [60.0, 3.0, -20.0], "axis": axis.tolist()}
    (effect,) = make_effects(CATALOGUE, [("plane-bow", "laser", options)])
    place = state.points - np.array([[60.0], [3.0], [-20.0]])
    along = axis @ place
    across = np.linalg.norm(place - np.outer(axis, along), axis=0)
    p = angle * np.array([1.0, distance, shift, shift**2])
    made = effect.delta(p, state)[0]
    np.testing.assert_allclose(
        made + angle * distance * along**2 / (2 * across**2),
        angle * (along - shift) ** 2 / (2 * across),
    )


def test_wobble_keeps_the_normal_a_unit_one_to_first_order():
    effect, bench, count = made(("mirror-wobble", "mirror", {}))
    tilts = effect.basis(bench.state)[:, :3]
    np.testing.assert_allclose(
        np.einsum("pin,in->pn", tilts, bench.state.planes[:3]), 0, atol=1e-15
    )


def test_scatter_acts_on_balls_alone_and_inwards():
    state = observations()
    (effect,) = make_effects(CATALOGUE, [("subsurface-scatter", "sensor", {})])
    depth, shrink = effect.basis(state)
    on_ball = state.ball > 0
    assert not depth[:, ~on_ball].any() and not shrink[:, ~on_ball].any()
    np.testing.assert_allclose(depth[:, on_ball], state.rays[:, on_ball])
    assert ((shrink * state.rays).sum(0)[on_ball] > 0).all()  # away from the camera
    flipped = effect.basis(replace(state, normals=-state.normals))
    np.testing.assert_allclose(flipped, effect.basis(state))


def test_incidence_shifts_along_the_ray_by_the_tangent():
    state = observations()
    (effect,) = make_effects(CATALOGUE, [("incidence-bias", "sensor", {})])
    shift = effect.delta(np.array([0.01]), state)
    np.testing.assert_allclose(shift, 0.01 * np.tan(state.incidence) * state.rays, rtol=1e-9)


def test_heat_is_taken_from_the_camera_the_room_or_the_clock():
    state = observations()
    (effect,) = make_effects(CATALOGUE, [("camera-thermal-drift", "camera", {})])
    room, time = state.covariates["temperature_c"], state.covariates["time_s"]
    for covariates, expected in (
        ({"temperature_camera_c": room + 5, "temperature_c": room}, room - 15),
        ({"temperature_c": room, "time_s": time}, room - 20),
        ({"time_s": time}, time / 3600),
    ):
        np.testing.assert_allclose(
            effect.basis(replace(state, covariates=covariates))[1, 0], expected
        )


@pytest.mark.parametrize(
    "name, where", [("camera-thermal-drift", "camera"), ("laser-drift", "laser")]
)
def test_one_law_of_warming_up_at_every_port(name, where):
    """63 % of the final value after one time constant, 95 % after three, nothing before the start."""
    state = SimpleNamespace(covariates={"time_s": np.array([0.0, 50.0, 150.0, 350.0])}, n=4)
    state.covariate = state.covariates.__getitem__
    progress = CATALOGUE[name](where, 100.0, 50.0).progress(state)
    assert progress == pytest.approx([0, 0, 1 - np.exp(-1), 1 - np.exp(-3)])


def test_a_warm_up_is_tested_with_time_constants_where_no_temperature_is_recorded():
    class Chain(SimpleNamespace):
        def places(self, kind):
            return (kind,)

        def varies(self, name):
            return name in self.varying

    effect = CATALOGUE["camera-thermal-drift"]
    timed = Chain(varying={"time_s"}, times=tuple(np.linspace(100.0, 3700.0, 181)))
    found = list(effect.candidates(timed))
    constants = [one.effect.time_constant_s for one in found]
    assert constants[0] == 0 and min(constants[1:]) == 60 and max(constants) == 5400
    assert {one.effect.start_s for one in found[1:]} == {100.0}
    assert sum(one.prior_weight for one in found) == pytest.approx(1)
    warm = Chain(varying={"time_s", "temperature_c"}, times=timed.times)
    assert [one.effect.time_constant_s for one in effect.candidates(warm)] == [0]
