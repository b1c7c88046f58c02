"""The check of words finds a word in prose, in parts of names and across the end of a line, and spares contracts."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
import check_language


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("As they were told.", "told"),
        ("def test_progress_is_told(): pass", "told"),
        ("class ToldApart: pass", "Told"),
        ("the_told_2 = 1", "told"),
        ("MJCF_TWIN = 1", "TWIN"),
        ("# two twins", "twins"),
        ("def tell_apart(a, b): pass", "tell_apart"),
        ("which tells two kinds apart", "tells two kinds apart"),
        ('"found with its masses "\n    f"found"', 'with its masses " f"found'),
        ("# with its masses\n# found", "with its masses # found"),
        ("a wave of three cycles a turn", "cycles a turn"),
        ("a joint with play", "with play"),
        ("what survives of it", "what survives"),
        ("the diagnosis abstains", "abstains"),
    ],
)
def test_a_word_is_found(text, word):
    assert [found for _, found, _ in check_language.find_in(text)] == [word]


@pytest.mark.parametrize(
    "text",
    [
        "the twine is unrolled, a foretold rivalry",
        "    yield row",
        'truth["twin"]',
        "workbench demo --no-pictures",
        "every file in sealed/ of a run",
        "the playback of a file",
        'outcome == "abstained"',
    ],
)
def test_other_words_and_contracts_are_spared(text):
    assert list(check_language.find_in(text)) == []


def test_pages_avoid_more_words_than_code_does(tmp_path):
    (tmp_path / "docs").mkdir()
    page = tmp_path / "docs" / "page.md"
    page.write_text("The joint turns.\n\n```\nit turns\n```\n\nBoth in turn; `turn`; turned off.\n")
    found = list(check_language.find_faults([page]))
    assert [(line, word) for _, line, word, _ in found] == [(1, "turns")]
    assert list(check_language.find_in("the joint turns")) == []


def test_the_line_is_that_of_the_word_behind_a_contract():
    text = '"twin"\n"sealed"\nand beside it'
    assert [line for line, _, _ in check_language.find_in(text)] == [3]


def test_tests_changelog_and_names_of_files_are_read(tmp_path):
    for name in ("tests/a.py", "CHANGELOG.md", "README.md", "workbench/page.js"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("anew\n")
    (tmp_path / "sensors").mkdir()
    (tmp_path / "sensors" / "twin_scanner.py").write_text("")
    found = check_language.find_faults(check_language.list_texts(tmp_path, []))
    assert sorted(path.name for path, *_ in found) == [
        "CHANGELOG.md",
        "README.md",
        "a.py",
        "page.js",
        "twin_scanner.py",
    ]
