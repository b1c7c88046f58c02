"""Where recordings come from: the registry, downloading, and the readers of real sets where those are present."""

import hashlib
import json
import re

import numpy as np
import pytest

import datasets
from datasets import registry
from datasets.errors import InputError

VARIANTS = [
    f"{s.name}:{v}" if v else s.name
    for s in registry.sources().values()
    for v in s.variants
    if s.measures == "external-point"
]
ROWS = {
    "irb120_faro": 5982,
    "irb120_wu_arm": 148,
    "motoman_leica_ctu:right": 212,
    "motoman_leica_ctu:left": 208,
    "fanuc165f_innopolis": 720,
    "hilti_jaibot_tilt:flat": 444,
}


def real(name: str):
    """The real recording, or a skip that says what is missing."""
    if registry.find(name) is None:
        pytest.skip(
            f"{name.partition(':')[0]} is in neither of {registry.places()}; set {registry.SETTING}"
        )
    return datasets.read(name)


def apart(recording, a: int, b: int) -> np.ndarray:
    """Distance of two reflectors in every pose that shows both, mm."""
    pose = recording.columns["pose"]
    places = {
        k: dict(zip(pose[recording.reflector == k], recording.points[recording.reflector == k]))
        for k in (a, b)
    }
    return np.array(
        [np.linalg.norm(p - places[b][key]) for key, p in places[a].items() if key in places[b]]
    )


def test_every_set_is_named_with_source_terms_and_checksums():
    for source in registry.sources().values():
        assert source.page.startswith("https://") or re.fullmatch(r"[0-9a-f]{40}", source.commit)
        assert source.licence and source.title
        for file in source.files:
            assert re.fullmatch(r"[0-9a-f]{64}", file.sha256)
            if not file.remote:
                assert source.by_hand
                continue
            assert source.url_of(file).startswith(
                f"https://raw.githubusercontent.com/{source.repository}/{source.commit}/"
            )
            assert " " not in source.url_of(file)


def test_listing_says_where_each_set_is(monkeypatch, tmp_path):
    monkeypatch.setenv(registry.SETTING, str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    rows = {row["name"]: row for row in datasets.listing()}
    assert set(rows) == set(registry.sources())
    assert all(row["folder"] is None for row in rows.values())
    wanted = registry.source("fanuc165f_innopolis")
    (tmp_path / wanted.name).mkdir()
    (tmp_path / wanted.name / wanted.files[0].path).write_bytes(b"there")
    assert datasets.find(wanted.name) == tmp_path / wanted.name


def test_missing_set_says_how_to_get_it(monkeypatch, tmp_path):
    monkeypatch.setenv(registry.SETTING, str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with pytest.raises(datasets.InputError, match="workbench datasets get irb120_faro"):
        datasets.read("irb120_faro")


@pytest.mark.parametrize(
    ("name", "words"),
    [("irb120_faro:nonsense", "read-back"), ("motoman_leica_ctu", "motoman_leica_ctu:left")],
)
def test_unknown_variant_names_the_known_ones(name, words):
    with pytest.raises(datasets.InputError, match=words):
        datasets.read(name)


def test_changed_file_is_refused(monkeypatch, tmp_path):
    wanted = registry.source("fanuc165f_innopolis")
    (tmp_path / wanted.name).mkdir()
    (tmp_path / wanted.name / wanted.files[0].path).write_bytes(b"something else")
    monkeypatch.setenv(registry.SETTING, str(tmp_path))
    with pytest.raises(datasets.InputError, match="sha256 19face499435"):
        datasets.read(wanted.name)


def small_source(content: bytes) -> registry.Source:
    file = registry.RemoteFile("data/a.bin", hashlib.sha256(content).hexdigest(), "x/a b.bin")
    return registry.Source(
        "small",
        "a small set",
        "external-point",
        "CC0",
        ("",),
        (file,),
        "someone/something",
        "0" * 40,
    )


def serve(monkeypatch, answer):
    """Put `answer(url)` in the place of the network, and one small set in the place of the known ones."""
    monkeypatch.setattr(registry, "sources", lambda: {"small": small_source(b"good")})
    monkeypatch.setattr("urllib.request.urlopen", answer)


class Answer:
    """What urlopen gives: something to read, once."""

    def __init__(self, content: bytes):
        self.content = content

    def __enter__(self):
        return self

    def __exit__(self, *problem):
        return False

    def read(self, size: int = -1) -> bytes:
        return self.content if size < 0 else self.content[:size]


def test_get_fetches_checks_and_keeps(monkeypatch, tmp_path):
    asked = []
    serve(monkeypatch, lambda url, timeout: asked.append(url) or Answer(b"good"))
    folder = datasets.get("small", tmp_path)
    assert (folder / "data" / "a.bin").read_bytes() == b"good"
    assert [p.name for p in (folder / "data").iterdir()] == ["a.bin"]
    datasets.get("small", tmp_path)
    assert asked == [
        "https://raw.githubusercontent.com/someone/something/" + "0" * 40 + "/x/a%20b.bin"
    ]


def test_get_refuses_changed_content(monkeypatch, tmp_path):
    serve(monkeypatch, lambda url, timeout: Answer(b"bad"))
    with pytest.raises(datasets.InputError, match="the source has changed"):
        datasets.get("small", tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_get_without_network_says_what_to_do(monkeypatch, tmp_path):
    def no_network(url, timeout):
        raise OSError("no route to host")

    serve(monkeypatch, no_network)
    with pytest.raises(datasets.InputError, match=f"no route to host.*{registry.SETTING}"):
        datasets.get("small", tmp_path)


@pytest.mark.parametrize("name", VARIANTS)
def test_real_set_reads_in_plausible_units(name):
    recording = real(name)
    assert recording.n == ROWS.get(name, recording.n) and recording.n > 15
    assert recording.measures == "external-point"
    joints, prismatic = recording.joints, "q1_mm" in recording.columns
    assert np.all(np.abs(joints[:, prismatic:]) < 7.0) and np.ptp(joints, axis=0).max() > 1e-5
    assert 500 < np.abs(recording.points).max() < 20000
    assert np.all(recording.sigma > 0) and np.all(recording.sigma < 1)
    assert (
        recording.source.startswith("https://github.com/")
        and recording.licence
        and len(recording.sha256) == 64
    )


@pytest.mark.parametrize("name", VARIANTS)
def test_real_set_survives_our_own_format(name, tmp_path):
    """Written as recording/1 and read back with every check on, a real recording is the same."""
    first = real(name)
    second = datasets.read(datasets.write(first, tmp_path / "copy"))
    np.testing.assert_array_equal(second.joints, first.joints)
    np.testing.assert_array_equal(second.points, first.points)
    np.testing.assert_array_equal(second.poses, first.poses)
    np.testing.assert_array_equal(second.moving, first.moving)
    assert set(second.covariates) == set(first.covariates)


@pytest.mark.parametrize("pair", [(1, 2), (1, 3), (2, 3)])
def test_faro_reflectors_keep_their_distance(pair):
    recording = real("irb120_faro")
    lengths = apart(recording, *pair)
    assert len(lengths) == 1000
    assert abs(np.median(lengths) - 150.4) < 0.3
    assert np.std(lengths) < 0.0075


def test_faro_base_reflectors_are_filtered_and_do_not_move():
    recording = real("irb120_faro")
    assert recording.moving.sum() == 3000
    counts = [np.sum(recording.reflector == k) for k in (4, 5, 6)]
    assert counts == [1000, 998, 984]
    for k in (4, 5, 6):
        points = recording.points[recording.reflector == k]
        assert np.abs(points - np.median(points, axis=0)).max() <= 0.5


def test_faro_read_back_is_near_the_command():
    commanded, answered = real("irb120_faro"), real("irb120_faro:read-back")
    np.testing.assert_array_equal(commanded.points, answered.points)
    lag = np.rad2deg(np.abs(commanded.joints - answered.joints))
    assert 0 < lag.max() < 1


def test_wu_points_keep_their_distance_and_sets_are_named():
    recording = real("irb120_wu_arm")
    assert [np.sum(recording.columns["set"] == k) for k in (0, 1, 2)] == [108, 10, 30]
    assert [len(set(recording.poses[recording.columns["set"] == k])) for k in (0, 1, 2)] == [
        36,
        10,
        30,
    ]
    for pair, length in (((1, 2), 18.1), ((1, 3), 22.3), ((2, 3), 18.1)):
        assert abs(apart(recording, *pair).mean() - length) < 0.1
        assert apart(recording, *pair).std() < 0.15


def test_motoman_repeats_are_one_pose():
    recording = real("motoman_leica_ctu:repeat-table")
    assert len(set(recording.poses)) == 1
    assert np.ptp(recording.points, axis=0).max() < 0.5


def test_fanuc_repeats_and_markers():
    recording = real("fanuc165f_innopolis")
    assert len(set(recording.poses)) == 24
    spread = [
        np.std(recording.points[(recording.poses == g) & (recording.reflector == 1)], axis=0).max()
        for g in range(24)
    ]
    assert 0.005 < np.median(spread) < 0.1
    assert apart(recording, 1, 2).std() < 0.03


def test_ur10_poses_are_in_order_of_time_with_unit_quaternions():
    recording = real("ur10_ipa_tmac_A")
    assert recording.measures == "external-pose" and recording.n == 11911
    assert np.all(np.diff(recording.columns["time_s"]) > 0) and recording.columns["time_s"][0] == 0
    assert sorted(recording.sample_ids) == list(range(1, 11912))
    quaternion = np.stack([recording.columns[f"q{c}"] for c in "wxyz"])
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=0), 1, atol=1e-12)
    assert (
        22 < recording.columns["temperature_c"].min()
        and recording.columns["temperature_c"].max() < 25
    )
    assert np.abs(recording.points - np.median(recording.points, axis=0)).max() < 1000
    assert recording.licence == "MIT" and recording.source.startswith("https://github.com/")


def test_a_folder_of_a_known_set_is_read_like_its_name(monkeypatch):
    named = real("ur10_ipa_tmac_A")
    assert datasets.read(named.folder).name == named.name
    monkeypatch.chdir(named.folder)
    assert datasets.read(".").n == named.n
    monkeypatch.chdir(named.folder.parent)
    assert datasets.read(named.name).n == named.n
    with pytest.raises(datasets.InputError, match="expected one of ur10_ipa_tmac_A, found 'x'"):
        datasets.read(f"{named.folder}:x")


def test_ur10_orientations_agree_with_the_joint_readings():
    """Another order of the Euler angles would leave tens of degrees."""
    from workbench.jobs.robot.calibrate import calibrate

    recording = real("ur10_ipa_tmac_A")
    found = calibrate(recording.select(np.arange(0, recording.n, 60)), plan=(), folds=3)
    assert found.held_out["rms_mm"] < 1.0 and found.held_out["rotation_rms_deg"] < 0.15


def test_hilti_lift_and_tilt():
    recording = real("hilti_jaibot_tilt:seesaw")
    assert np.all(np.diff(recording.columns["time_s"]) >= 0) and recording.columns["time_s"][0] == 0
    np.testing.assert_allclose(
        recording.columns["q1_mm"], recording.columns["column_height_mm"], atol=12
    )
    gravity = np.linalg.norm([recording.columns[f"accel_base_{a}_m_s2"] for a in "xyz"], axis=0)
    assert np.all(np.abs(gravity - 9.81) < 0.05)
    assert set(recording.columns["set"]) == {0, 1} and set(recording.columns["upside_down"]) == {
        0,
        1,
    }
    lift = [m["ratio"] for m in recording.robot["mimic"].values()]
    assert sum(lift) == 1 and sum(m["offset"] for m in recording.robot["mimic"].values()) == -1.442


def test_a_run_folder_is_said_to_be_one_and_its_recording_named(tmp_path):
    answer = {"command": "calibrate", "input": "/data/cell-4"}
    (tmp_path / "answer.json").write_text(json.dumps(answer))
    (tmp_path / "residuals.csv").write_text("sample\n1\n")
    with pytest.raises(InputError, match="results of `workbench calibrate`; pass /data/cell-4"):
        datasets.read(tmp_path)


@pytest.mark.parametrize("text", ["{", "[1]", '{"command": 3}'])
def test_another_file_called_answer_does_not_hide_tables_to_import(tmp_path, text):
    (tmp_path / "answer.json").write_text(text)
    (tmp_path / "residuals.csv").write_text("sample\n1\n")
    with pytest.raises(InputError, match="run `workbench import` on this folder"):
        datasets.read(tmp_path)
