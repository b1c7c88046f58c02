"""Damaged and oversized files end in one sentence, within a second and without gigabytes of memory."""

import http.client
import json
import struct
import zlib

import cv2
import numpy as np
import pytest

import datasets
from datasets import registry
from datasets.importers.sources.clouds import read_cloud
from good_recordings import write_good
from sensors.camera.model import camera_from_keys, camera_keys
from sensors.images import read as read_image
from test_exports import BROWN
from workbench.core.errors import InputError
from workbench.core.text.structured_text import (
    ContentError,
    parse_json,
    parse_toml,
    read_toml,
    read_yaml,
)
from workbench.files.scene import read_scene
from workbench.files.solution_file import read_solution
from workbench.fitting.calibration_plans.plans import read_plan
from workbench.proving import protocol
from workbench.proving.prove import _settings, bring

TOML = {
    "deep nesting": "a = " + "[" * 3000,
    "integer of 5,000 digits": "a = " + "9" * 5000,
    "integer of 400 digits": "a = " + "9" * 400,
    "dotted key of 100,000 parts": "a." * 100_000 + "a = 1",
    "null character": 'a = "\\u0000"',
    "impossible date": "a = 2021-02-30",
    "no TOML": "a = = 1",
}
JSON = {
    "deep nesting": "[" * 100_000,
    "integer of 5,000 digits": "9" * 5000,
    "integer of 400 digits": '{"a": %s}' % ("9" * 400),
    "unpaired surrogate": '"\\ud800"',
    "no JSON": "{",
}


@pytest.mark.parametrize("name", TOML)
def test_damaged_toml_is_one_kind_of_error(name, tmp_path):
    with pytest.raises(ContentError):
        parse_toml(TOML[name])
    (tmp_path / "a.toml").write_text(TOML[name])
    for read in (read_scene, read_plan):
        with pytest.raises(InputError):
            read(tmp_path / "a.toml")


@pytest.mark.parametrize("name", JSON)
def test_damaged_json_is_one_kind_of_error(name):
    with pytest.raises(ContentError):
        parse_json(JSON[name])


def test_yaml_that_contains_itself_is_read_once(tmp_path):
    (tmp_path / "a.yaml").write_text("a: &a [*a]\n")
    assert len(read_yaml(tmp_path / "a.yaml")["a"]) == 1
    (tmp_path / "b.yaml").write_text("a: [" * 2000)
    with pytest.raises(ContentError):
        read_yaml(tmp_path / "b.yaml")


def test_a_file_name_with_a_null_character_is_an_error_of_the_content():
    with pytest.raises(ContentError, match="name"):
        read_toml("a\0.toml")


def test_valid_files_are_read_as_before():
    text = 'a.b.c = 1\r\n"x y" = [1.5, "ä"]\nd = 1979-05-27\n'
    assert parse_toml(text)["a"] == {"b": {"c": 1}}
    assert parse_json('{"a": [1, -1e300, "\\u00e4"]}') == {"a": [1, -1e300, "ä"]}


# --- solution.json ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def solution(tmp_path_factory):
    """Keys of a valid solution.json with two estimated parameters."""
    from robot_model import load_robot

    geometry = load_robot("abb_irb120").geometry
    names = ("theta", "d", "a", "alpha", "beta")
    values = {
        f"joint-{k + 1}.{name}{k + 1}": float(geometry[k, c])
        for k in range(len(geometry))
        for c, name in enumerate(names)
    }
    return {
        "format": "solution/1",
        "robot": {"builtin": "abb_irb120"},
        "effects": [],
        "values": values,
        "free": ["joint-1.theta1", "joint-2.d2"],
        "covariance": [[1e-8, 2e-6], [2e-6, 1e-2]],
        "load_centre_mm": [0.0, 0.0, 0.0],
        "held_out": {"rms_mm": 0.1},
        "nominal": {"rms_mm": 1.0},
        "converged": True,
        "outcome": "converged",
        "warnings": [],
        "fitted_range": {"q1_deg": [-10.0, 10.0]},
    }


WRONG = {
    "negative variance": ("covariance", [[-1e-8, 0.0], [0.0, 1e-2]]),
    "covariance not symmetric": ("covariance", [[1e-8, 2e-6], [-2e-6, 1e-2]]),
    "correlation above one": ("covariance", [[1e-8, 2e-5], [2e-5, 1e-2]]),
    "covariance of nan": ("covariance", [[float("nan"), 0.0], [0.0, 1.0]]),
    "covariance of another size": ("covariance", [[1.0]]),
    "two load coordinates": ("load_centre_mm", [0.0, 1.0]),
    "infinite load": ("load_centre_mm", [0.0, 1.0, float("inf")]),
    "a parameter twice": ("free", ["joint-1.theta1", "joint-1.theta1"]),
    "exchanged range": ("fitted_range", {"q1_deg": [10.0, -10.0]}),
    "negative error": ("held_out", {"rms_mm": -0.1}),
    "integer of 400 digits": ("load_centre_mm", [10**400, 0, 0]),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_solution_with_contradictory_numbers_is_refused(name, solution, tmp_path):
    key, value = WRONG[name]
    (tmp_path / "solution.json").write_text(json.dumps({**solution, key: value}))
    with pytest.raises(InputError, match="solution.json"):
        read_solution(tmp_path)


def test_a_valid_solution_is_read(solution, tmp_path):
    (tmp_path / "solution.json").write_text(json.dumps(solution))
    assert read_solution(tmp_path).covariance.shape == (2, 2)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("fx_px", 1e-300),
        ("fy_px", float("inf")),
        ("width_px", float("inf")),
        ("width_px", 10**9),
        ("cx_px", 1e9),
        ("distortion", [1e9, 0, 0, 0, 0]),
    ],
)
def test_a_camera_that_cannot_exist_is_refused(key, value):
    assert camera_from_keys(camera_keys(BROWN), "camera.toml") == BROWN
    with pytest.raises(InputError, match="camera.toml"):
        camera_from_keys({**camera_keys(BROWN), key: value}, "camera.toml")


# --- prove -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"seed": "a", "own": null, "planned": {}}', "[" * 9999]
)
def test_broken_settings_of_a_benchmark_run(tmp_path, text):
    (tmp_path / "settings.json").write_text(text)
    with pytest.raises(InputError, match="cannot be continued"):
        _settings(tmp_path / "settings.json")


@pytest.mark.parametrize("text", ["{", "[1]", '{"a": 1}', '{"a": "\\ud800"}'])
def test_broken_hashes_of_a_benchmark_run(tmp_path, text):
    (tmp_path / "seals.json").write_text(text)
    with pytest.raises(InputError, match="cannot be continued"):
        protocol.published(protocol.BenchmarkRun(tmp_path))


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("SHA256SUMS", b"abc"),
        ("SHA256SUMS", b"\xff\xfe\xff"),
        ("sealed/case.json", b'{"effects": [{"effect": 1, "where": []}]}'),
        ("sealed/case.json", b"\xff"),
        ("sealed/case.json", b'{"effects": null}'),
        ("sealed/case.json", b"[" * 5000),
    ],
)
def test_broken_truths_of_the_user(tmp_path, file, content):
    write_good(tmp_path / "own" / "recordings" / "case", "ball-centre")
    (tmp_path / "own" / "sealed").mkdir()
    (tmp_path / "own" / "sealed" / "case.json").write_text('{"effects": []}')
    (tmp_path / "own" / file).write_bytes(content)
    with pytest.raises(InputError):
        bring(protocol.BenchmarkRun(tmp_path / "exam"), tmp_path / "own")


# --- limits ----------------------------------------------------------------------------------------------------------


def samples(folder, change):
    path = write_good(folder / "good", "external-pose") / "samples.csv"
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError) as caught:
        datasets.read(folder / "good")
    return str(caught.value)


def test_a_header_of_100_000_columns(tmp_path):
    more = ",".join(f"c{k}" for k in range(100_000))
    assert "at most 2000 columns" in samples(tmp_path, lambda text: f"{more},{text}")


def test_a_note_of_100_kB(tmp_path):
    def change(text):
        head, *rows = text.strip().split("\n")
        noted = [f"{row},{'x' * 100_000 if k == 2 else ''}" for k, row in enumerate(rows)]
        return "\n".join([f"{head},note", *noted]) + "\n"

    assert "at most 2000 characters" in samples(tmp_path, change)


def png(width, height, depth=8, colour=0, data=b""):
    def chunk(name, body):
        return (
            struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        )

    head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    parts = chunk(b"IHDR", head), chunk(b"IDAT", zlib.compress(data)), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.parametrize("size", [(60_000, 60_000, 8, 0), (12_000, 12_000, 16, 6)])
def test_an_image_that_asks_for_gigabytes(tmp_path, size):
    (tmp_path / "bomb.png").write_bytes(png(*size))
    with pytest.raises(InputError, match="at most 800 MB"):
        read_image(tmp_path / "bomb.png")


@pytest.mark.parametrize("ending", [".png", ".jpg", ".bmp"])
def test_the_announced_size_is_that_of_the_image(ending):
    from sensors.image_size import announced_size

    made = cv2.imencode(ending, np.zeros((30, 40, 3), np.uint8))[1].tobytes()
    assert announced_size(made)[:2] == (40, 30)


@pytest.mark.parametrize(
    "content",
    [
        b"ply\nformat ascii 1.0\nelement vertex 4\n" + b"x" * 5000 + b"\nend_header\n",
        b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nend_header\n" + b"1" * 5000,
        b"ply\nformat binary_little_endian 1.0\nelement vertex 999999999999\nend_header\n",
        b"ply\nformat ascii 1.0\nelement vertex 4\nproperty end_header 1\nend_header\n0\n1\n2\n3\n",
        b"no cloud",
    ],
)
def test_a_ply_file_that_ends_the_parser_of_open3d(tmp_path, content):
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(InputError, match="a.ply"):
        read_cloud(tmp_path / "a.ply", 100)


class Answer:
    """An HTTP answer of a size, or one that breaks off."""

    def __init__(self, size):
        self.size = size

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def read(self, most=None):
        if self.size is None:
            raise http.client.IncompleteRead(b"abc", 100)
        assert most is not None, "an answer of any size would be kept in memory"
        return b"\0" * min(self.size, most)


@pytest.mark.parametrize(("size", "said"), [(2_000_000, "at most 1 MB"), (None, "none")])
def test_a_download_is_limited_and_may_break_off(monkeypatch, tmp_path, size, said):
    monkeypatch.setattr("urllib.request.urlopen", lambda *_, **__: Answer(size))
    monkeypatch.setattr(registry, "LIMIT_MB", 1)
    with pytest.raises(InputError, match=said):
        registry.get("irb120_faro", tmp_path)
