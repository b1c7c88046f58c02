"""File names from identifiers: unique on every file system, reversible, and no name that Windows reserves."""

import hashlib
from urllib.parse import unquote

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from workbench.core.text.file_names import LONGEST, differ_in_case_only, file_name
from workbench.jobs.sensor import scan

AWKWARD = st.sampled_from(
    [
        "left/1",
        "right/1",
        "left",
        "Left",
        "LEFT",
        "Шов",
        "球",
        "..",
        ".",
        "con",
        "CON",
        "con.x",
        "COM1",
        "nul",
        "a b",
        "a%20b",
        "a+b",
        "-rf",
        "~",
        "%",
        "",
        "x.",
        "é",
        "é",
        "K",
        "K",
        "ſ",
        "s",
        "S",
    ]
)
IDS = st.one_of(
    AWKWARD,
    st.text(max_size=20),
    st.text("aAbB/.", max_size=4),
    st.text("é球x", min_size=60, max_size=90),
)
WINDOWS = set('<>:"/\\|?*') | {chr(code) for code in range(32)}


def names_of(identifiers):
    same = differ_in_case_only(identifiers)
    return [file_name(identifier, identifier in same) for identifier in identifiers]


@given(st.lists(IDS, unique=True, max_size=12))
@example(["left/1", "right/1"])
@example(["Шов", "球"])
@example(["Left", "left"])
def test_no_two_identifiers_share_a_file_where_case_is_ignored(identifiers):
    names = names_of(identifiers)
    assert len({name.casefold() for name in names}) == len(identifiers)


@given(IDS)
def test_a_name_is_reversible_unless_it_was_cut(identifier):
    for encode_capitals in (False, True):
        name = file_name(identifier, encode_capitals)
        assert len(name) <= LONGEST
        if "~" not in name and identifier:
            assert unquote(name, errors="surrogatepass") == identifier


@given(IDS)
def test_a_name_is_safe_on_every_system(identifier):
    name = file_name(identifier)
    assert name and name.isascii() and not set(name) & WINDOWS
    assert not name.startswith((".", "-")) and not name.endswith((".", " "))
    device = name.partition(".")[0].lower()
    assert device not in {
        "con",
        "prn",
        "aux",
        "nul",
        *(f"{kind}{k}" for kind in ("com", "lpt") for k in range(10)),
    }


def test_a_long_name_is_cut_and_still_unique():
    one, other = "球" * 90, "球" * 91
    assert file_name(one) != file_name(other)
    assert file_name(one).endswith(hashlib.sha256(one.encode()).hexdigest()[:16])


def test_plain_names_stay_as_they_are():
    assert names_of(["1", "S01", "scan-3_b.2"]) == ["1", "S01", "scan-3_b.2"]


@pytest.mark.parametrize("ids", [("left/1", "right/1"), ("Шов", "球"), ("Left", "left")])
def test_every_scan_gets_a_cloud_of_its_own(ids, tmp_path, monkeypatch):
    """`left/1` and `right/1` were both written as 1.ply, and the answer named that file twice."""
    written = {}
    monkeypatch.setattr(
        scan, "write_cloud", lambda path, points: written.setdefault(path.name.casefold(), points)
    )
    monkeypatch.setattr(scan, "reconstructed", lambda *_: (np.zeros((3, 1)), ""))
    number = np.zeros(1, int)
    empty = np.zeros((2, 1)), number, number, np.ones(1), np.zeros((2, 1)), {}, {}, ()
    monkeypatch.setattr(scan._Work, "stripes", lambda self, rows: empty)
    monkeypatch.setattr(scan._Work, "balls", lambda self, *_: ((), "", ()))
    monkeypatch.setattr(scan._Work, "steps", frozenset({0}))
    monkeypatch.setattr(scan, "figures", lambda *_: ())

    class Nothing:
        balls = {}

    work = scan._Work(Nothing, None, tmp_path, None, differ_in_case_only(ids))
    made = [work((name, [{"step": 0, "image": "x.png"}])) for name in ids]
    assert len(written) == len({one.cloud.casefold() for one in made}) == len(ids)
