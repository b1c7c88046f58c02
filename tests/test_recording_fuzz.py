"""Recordings broken at random: whatever the reader is given, only InputError may come out of it."""

import shutil
import tempfile
import warnings
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import datasets
from good_recordings import write_good

QUICK = settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
TEXTS = ("recording.toml", "robot.toml", "samples.csv", "artefact.csv", "images.csv")
MEASURES = {
    "ball-centre": TEXTS[:4],
    "external-pose": TEXTS[:3],
    "scan-images": (*TEXTS[:3], "images.csv", "images/a.png"),
}
CELLS = st.one_of(
    st.text(max_size=12),
    st.floats(width=64).map(str),
    st.integers().map(str),
    st.sampled_from(
        [
            "",
            "nan",
            "-inf",
            "1e999",
            "9" * 400,
            "0x10",
            "1_0",
            '"',
            "\0",
            "\r",
            "-0",
            "None",
            "true",
            "½",
            "٣",
            "../x",
            "=1+1",
        ]
    ),
)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """One good folder a kind, with its samples also as Parquet."""
    made = {m: write_good(tmp_path_factory.mktemp("good") / m, m) for m in MEASURES}
    whole = datasets.write(
        datasets.read(made["external-pose"]), made["external-pose"].parent / "parquet", "parquet"
    )
    return made | {"parquet": whole}


def read_changed(folder: Path, file: str, content: bytes) -> None:
    """Read a copy of `folder` in which one file holds `content`; InputError is the only way to fail."""
    with tempfile.TemporaryDirectory() as home, warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        copy = shutil.copytree(folder, Path(home) / "copy")
        (copy / file).write_bytes(content)
        try:
            recording = datasets.read(copy)
        except datasets.InputError as problem:
            assert "\n" not in str(problem) and str(problem).endswith(".")
        else:
            _use(recording)


def _use(recording) -> None:
    """What was read can be used."""
    arrays = [
        recording.sample_ids,
        recording.joints,
        recording.moving,
        recording.reflector,
        recording.ball,
        recording.poses,
    ]
    assert {len(a) for a in arrays} == {recording.n}


@QUICK
@given(data=st.data())
def test_mutated_bytes(good, data):
    measures = data.draw(st.sampled_from(sorted(MEASURES)))
    file = data.draw(st.sampled_from(MEASURES[measures]))
    content = bytearray((good[measures] / file).read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content)))
        content[at : at + data.draw(st.integers(0, 8))] = data.draw(st.binary(max_size=8))
    read_changed(good[measures], file, bytes(content))


@QUICK
@given(data=st.data())
def test_mutated_parquet(good, data):
    content = bytearray((good["parquet"] / "samples.parquet").read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    content[at : at + data.draw(st.integers(1, 6))] = data.draw(st.binary(max_size=6))
    read_changed(good["parquet"], "samples.parquet", bytes(content))


@QUICK
@given(data=st.data())
def test_mutated_cells(good, data):
    measures = data.draw(st.sampled_from(sorted(MEASURES)))
    file = data.draw(st.sampled_from([f for f in MEASURES[measures] if f.endswith(".csv")]))
    rows = [line.split(",") for line in (good[measures] / file).read_text().splitlines()]
    for _ in range(data.draw(st.integers(1, 3))):
        row = data.draw(st.sampled_from(rows))
        row[data.draw(st.integers(0, len(row) - 1))] = data.draw(CELLS)
    read_changed(
        good[measures], file, "\n".join(map(",".join, rows)).encode("utf-8", "surrogatepass")
    )


@QUICK
@given(data=st.data())
def test_mutated_values(good, data):
    """A key of a TOML file gets another value, of any type."""
    file = data.draw(st.sampled_from(TEXTS[:2]))
    lines = (good["ball-centre"] / file).read_text().splitlines()
    at = data.draw(st.sampled_from([k for k, line in enumerate(lines) if "=" in line]))
    value = data.draw(
        st.sampled_from(
            [
                "0",
                "-1",
                "1e308",
                "nan",
                "inf",
                '""',
                '"x"',
                "true",
                "[]",
                "{}",
                "[[1]]",
                "9" * 400,
                "1979-05-27",
                '"../../x"',
                '"\\u0000"',
                "'~'",
                "[" * 2000 + "]" * 2000,
                '["a", 1]',
                '"' + "a" * 5000 + '"',
            ]
        )
    )
    lines[at] = lines[at].split("=")[0] + "= " + value
    read_changed(good["ball-centre"], file, "\n".join(lines).encode())


@QUICK
@given(content=st.binary(max_size=200), file=st.sampled_from(TEXTS[:4]))
def test_any_bytes(good, content, file):
    read_changed(good["ball-centre"], file, content)
