"""The maker of blinded images: its own optics, its files, and that it shares no code with the code under test."""

import ast
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import datasets
from datasets.makers import blind_images as maker
from datasets.makers.blind_images_render import Balls, Board, developed
from datasets.makers.blind_images_scanner import lens_of, light_of

FEW = maker.Counts(boards=2, scans=1, steps=2)
FILES = sorted(Path(maker.__file__).parent.glob("blind_images*.py"))


def light(**changes):
    return replace(light_of(np.random.default_rng(5)), **changes)


def test_the_maker_imports_nothing_of_the_workbench():
    allowed = set(sys.stdlib_module_names) | {"numpy", "scipy", "cv2"}
    for file in FILES:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                own = name.startswith("datasets.makers.blind_images")
                assert own or name.partition(".")[0] in allowed, f"{file.name} imports {name}"


def test_rays_lead_back_to_their_pixels_through_any_glass():
    lens = replace(
        lens_of(np.random.default_rng(2)), glass=np.array([0.2, -0.1, 0.15, 0.1, -0.2, 0.1])
    )
    u, v = np.linspace(0, 639, 40), np.linspace(0, 511, 30)
    rays = lens.rays(u, v)
    seen = lens.project(rays[:2] / rays[2])
    assert np.abs(seen[0] - u).max() < 1e-5
    assert np.abs(seen[1] - v[:, None]).max() < 1e-5


def test_light_of_a_cone_leaves_at_one_angle_from_the_plane_and_turns_twice_as_far_as_the_mirror():
    cone = light(cone=0.01)
    source, normal = cone.thrown(0.03)
    rng = np.random.default_rng(0)
    along = np.cross(normal, rng.normal(size=(50, 3))).T
    along = along / np.linalg.norm(along, axis=0)
    points = source[:, None] + (
        np.cos(0.01) * along + np.sin(0.01) * normal[:, None]
    ) * rng.uniform(100, 200, 50)
    assert np.abs(cone.plane_distance(points, 0.03)).max() < 1e-9
    flat = light()
    flat = replace(flat, normal=flat.face - flat.axis * (flat.axis @ flat.face))
    first, second = (flat.thrown(angle)[1] for angle in (0.0, 0.1))
    assert np.arccos(first @ second) == pytest.approx(0.2, abs=1e-9)


def test_every_flaw_of_the_mirror_is_nothing_at_size_zero_and_moves_the_light_else():
    points = np.array([[0.0, 20.0, -30.0], [10.0, -20.0, 0.0], [120.0, 130.0, 110.0]])
    still = light()
    where = still.plane_distance(points, still.truly(0.1, 0.05))
    for flaw in (
        {"wobble": (1e-3, 0.0, 2.0, 0.3)},
        {"wobble": (0.0, 0.05, 1.0, 0.0)},
        {"encoder": (1e-4, 7, 0.5)},
        {"late": 1e-3},
        {"cone": 1e-3},
    ):
        moved = replace(still, **flaw)
        assert np.abs(moved.plane_distance(points, moved.truly(0.1, 0.05)) - where).max() > 1e-3
    assert still.truly(0.1, 0.05) == 0.1


def test_rays_meet_a_bent_board_on_its_arc():
    board = Board(
        11,
        8,
        8.0,
        np.diag([1.0, -1.0, -1.0]),
        np.array([-40.0, 28.0, 120.0]),
        bend=1e-4,
        second_bend=-5e-5,
        bend_axis=0.4,
    )
    rays = np.random.default_rng(1).uniform([[-0.25], [-0.2], [1]], [[0.25], [0.2], [1]], (3, 200))
    points, albedo = board.meet(rays / np.linalg.norm(rays, axis=0))
    local = board.rotation.T @ (points - board.place[:, None])
    assert np.nanmax(np.abs(local[2] - board.height(*local[:2]))) < 1e-7
    assert np.nanmax(np.abs(local[2])) > 0.05
    assert set(np.unique(albedo)) == {0.22, 0.85}


def test_rays_meet_the_nearest_ball_on_its_surface():
    balls = Balls(np.array([[0.0, 3.0], [0.0, 0.0], [120.0, 160.0]]), np.array([10.0, 15.0]))
    rays = np.random.default_rng(1).uniform(
        [[-0.12], [-0.12], [1]], [[0.12], [0.12], [1]], (3, 500)
    )
    points, _ = balls.meet(rays / np.linalg.norm(rays, axis=0))
    off = np.linalg.norm(points[:, None] - balls.centres[:, :, None], axis=0) - balls.radii[:, None]
    seen = np.isfinite(points[0])
    assert np.abs(off[:, seen]).min(0).max() < 1e-9
    assert (points[2, seen] < 161).all()
    assert np.allclose(np.linalg.norm(balls.normals(points[:, seen]), axis=0), 1)


def test_noise_of_an_image_is_that_of_photons():
    light_ = np.full((200, 200), 0.5)
    grey = developed(light_, np.random.default_rng(0)).astype(float)
    assert grey.mean() == pytest.approx(3 + 0.5 * 252, abs=0.1)
    assert grey.std() == pytest.approx(np.sqrt(4500 + 100) * 252 / 9000, rel=0.03)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    return folder, {
        name: maker.make(3, folder / str(name), name, counts=FEW) for name in (None, "plane-bow")
    }


def test_a_made_folder_is_a_recording_with_all_its_images(made):
    recording = datasets.read(made[0] / "None")
    roles = [row["role"] for row in recording.images]
    assert recording.measures == "scan-images"
    assert (roles.count("board"), roles.count("board-laser"), roles.count("scan")) == (2, 4, 2)
    assert all((made[0] / "None" / row["image"]).exists() for row in recording.images)
    assert recording.balls[3][3] == 16.0


def test_the_truth_goes_to_the_caller_and_not_into_the_folder(made):
    folder, truths = made
    assert truths[None]["effects"] == []
    assert [(e["effect"], e["where"]) for e in truths["plane-bow"]["effects"]] == [
        ("plane-bow", "laser")
    ]
    names = {str(p.relative_to(folder / "None")) for p in (folder / "None").rglob("*")}
    assert names == {
        str(p.relative_to(folder / "plane-bow")) for p in (folder / "plane-bow").rglob("*")
    }
    for file in ("recording.toml", "images.csv", "artefact.csv"):
        assert (folder / "None" / file).read_bytes() == (folder / "plane-bow" / file).read_bytes()


def test_the_same_seed_makes_the_same_images_and_a_flaw_changes_only_what_it_acts_on(
    made, tmp_path
):
    maker.make(3, tmp_path / "again", counts=FEW)
    for row in datasets.read(tmp_path / "again").images:
        first = (made[0] / "None" / row["image"]).read_bytes()
        assert (tmp_path / "again" / row["image"]).read_bytes() == first
        if row["image"] == "images/board-01.png":  # before any light of the laser
            assert (made[0] / "plane-bow" / row["image"]).read_bytes() == first
    changed = made[0] / "plane-bow" / "images/stripe-01-01.png"
    assert changed.read_bytes() != (made[0] / "None" / "images/stripe-01-01.png").read_bytes()


def test_every_effect_has_a_place_and_an_unknown_one_is_refused(tmp_path):
    assert set(maker.EFFECTS.values()) == {
        "laser",
        "mirror",
        "artefact",
        "camera",
        "sensor",
        "time",
    }
    with pytest.raises(KeyError):
        maker.make(1, tmp_path / "x", "wear")


@pytest.mark.slow
def test_a_flaw_in_whole_images_is_named_by_the_diagnosis(tmp_path):
    from workbench.diagnosis.scanner import sensor
    from workbench.diagnosis.search.select import find

    truth = maker.make(11, tmp_path / "case", "board-bow")
    found = find(sensor.bench_of(datasets.read(tmp_path / "case"))).findings
    assert [(f.effect, f.where) for f in found] == [
        (e["effect"], e["where"]) for e in truth["effects"]
    ]
