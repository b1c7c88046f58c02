"""The house-style check: it passes on this project, and it sees each fault that it is for."""

import sys

import pytest

from conftest import ROOT

sys.path.insert(0, str(ROOT / "tools"))

import check_names  # noqa: E402
import check_style  # noqa: E402

FAULTS = {
    "no docstring": ("x = 1\n", "no docstring"),
    "long function": ('"""Doc."""\n\n\ndef f():\n' + "    x = 1\n" * 51, "f has 51 lines"),
    "long file": ('"""Doc."""\n' + "# why\n" * 500, "501 lines"),
    "deep class": (
        '"""Doc."""\n\n\nclass A: pass\nclass B(A): pass\nclass C(B): pass\n',
        "class C stands 2",
    ),
    "machine path": ('"""Doc."""\n\nPLACE = "' + "/" + 'tmp/x"\n', "path of one machine"),
    "home path": ('"""Doc."""\n\nPLACE = "' + "/" + 'home/me"\n', "path of one machine"),
}
FINE = {
    "fifty lines": '"""Doc."""\n\n\ndef f():\n' + "    x = 1\n" * 50,
    "one step": '"""Doc."""\n\n\nclass A(ValueError): pass\nclass B(A): pass\n',
    "address": '"""See https://example.org/home/page."""\n',
    "relative": '"""Doc."""\n\nPLACE = "..' + "/" + 'tmp/x"\n',
}


def faults(tmp_path, text, capsys):
    (tmp_path / "tools").mkdir()
    (tmp_path / "tools" / "one.py").write_text(text)
    count = check_style.main(tmp_path)
    return count, capsys.readouterr().out


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_seen_once(name, tmp_path, capsys):
    text, sentence = FAULTS[name]
    count, said = faults(tmp_path, text, capsys)
    assert count == 1, said
    assert sentence in said


@pytest.mark.parametrize("name", FINE)
def test_what_is_allowed_is_no_fault(name, tmp_path, capsys):
    count, said = faults(tmp_path, FINE[name], capsys)
    assert count == 0, said


def test_median_counts_packages(tmp_path, capsys):
    (tmp_path / "sensors").mkdir()
    (tmp_path / "sensors" / "one.py").write_text('"""Doc."""\n\n\ndef f():\n' + "    x = 1\n" * 13)
    assert check_style.main(tmp_path) == 1
    assert "median function body 13" in capsys.readouterr().out


def test_docstrings_do_not_count(tmp_path, capsys):
    text = '"""Doc."""\n\n\ndef f():\n    """Long.\n' + "    why\n" * 60 + '    """\n    return 1\n'
    count, said = faults(tmp_path, text, capsys)
    assert count == 0, said


NAMED = {
    "in a table": ('TABLE = ("joint-compliance", 1)\n', 1),
    "in a key": ('KEY = f"joint-{1}.joint-compliance.load"\n', 1),
    "in a message": ('WHY = "leave joint-compliance out"\n', 1),
    "in a docstring": ('"""Of joint-compliance."""\n', 0),
    "in its class": (
        'class A:\n    effect = "joint-compliance"\n    key = "joint-compliance"\n',
        0,
    ),
    "a longer word": ('WORD = "no-joint-compliance-here"\n', 0),
}


@pytest.mark.parametrize("name", NAMED)
def test_an_effect_is_named_in_its_class_alone(name, tmp_path, capsys):
    text, expected = NAMED[name]
    (tmp_path / "workbench").mkdir()
    (tmp_path / "workbench" / "one.py").write_text(text)
    assert check_names.main(tmp_path) == expected, capsys.readouterr().out


def test_this_project_names_effects_in_their_classes_alone(capsys):
    assert check_names.main(ROOT) == 0, capsys.readouterr().out


def test_prepositions_and_adverbs_are_no_names(tmp_path, capsys, monkeypatch):
    """Functions, parameters, fields and variables count, up to the ceiling of the package; words in names do not."""
    monkeypatch.setattr(check_names, "MOST_NAMES", {"sensors": 1})
    (tmp_path / "sensors").mkdir()
    place = tmp_path / "sensors" / "one.py"
    place.write_text("def rest_of(values, against):\n    return values\n")
    assert check_names.main(tmp_path) == 0, capsys.readouterr().out
    place.write_text("def _along(values, against):\n    rest = values\n    return rest\n")
    found = list(check_names.name_faults(tmp_path, "sensors"))
    assert [fault.split("'")[1] for fault in found] == ["_along", "against", "rest"]
    assert check_names.main(tmp_path) == 4  # the names, and that they are more than the ceiling


def test_density_counts_nodes_and_lines_of_bodies(tmp_path, capsys, monkeypatch):
    """Blank lines, comments and docstrings are no lines of code; a figure above its ceiling is a fault."""
    (tmp_path / "sensors").mkdir()
    text = '"""Doc."""\n\n\ndef f(x):\n    """Doc."""\n    # why\n    y = x\n\n    return y\n'
    (tmp_path / "sensors" / "one.py").write_text(text)
    monkeypatch.setattr(check_style, "DENSITY", {"": (4.0, 5)})
    assert check_style.main(tmp_path) == 0
    assert "all packages: 4.00 nodes a line, median function 5 nodes" in capsys.readouterr().out
    monkeypatch.setattr(check_style, "DENSITY", {"": (3.9, 5)})
    assert check_style.main(tmp_path) == 1
