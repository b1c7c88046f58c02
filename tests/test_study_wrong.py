"""What is wrong with a study is said in one sentence, with status 2, and nothing half-written is left."""

import errno
from pathlib import Path

import pyarrow.parquet as pq
import pytest

import study_scenes as scenes
from workbench.commands.cli import run
from workbench.core.errors import InputError, Stopped
from workbench.studies import tables
from workbench.studies.study import carried_out, read

AXIS = 'name = "c2"\npath = "scene.effect.1.values.compliance"\nlow = 1e-5\nhigh = 1e-4'
WRONG = {
    "unknown key": (("seed = 3", "seeds = 3"), "key seeds: this key is not known"),
    "unknown key of the scene": (
        ("samples = 20\nsigma", "sample = 20\nsigma"),
        "key sample: this key is not known",
    ),
    "impossible range": (
        ("low = 1e-5", "low = 1e-3"),
        "key vary.parameter.1: expected low below high, found 0.001 and 0.0001",
    ),
    "logarithm of nothing": (
        ("low = 1e-5", 'low = 0.0\nscale = "log"'),
        "expected low above 0 on a logarithmic scale",
    ),
    "no range": (("low = 1e-5", ""), "expected either low and high, or values"),
    "both": (
        ("low = 1e-5", "low = 1e-5\nvalues = [1.0]"),
        "expected either low and high, or values",
    ),
    "a path to nowhere": (
        ("scene.effect.1", "scene.effect.2"),
        "found no '2' in 'scene.effect.2.values.compliance'",
    ),
    "a path from nowhere": (
        ("scene.effect.1", "robot.effect.1"),
        "expected a path that begins with scene.",
    ),
    "out of the scene's range": (
        (AXIS, 'name = "s"\npath = "scene.sigma_mm"\nlow = -1.0\nhigh = 1.0'),
        "parameter s = -1.0: scene, key sigma_mm: input should be greater than 0",
    ),
    "unknown parameter of an effect": (
        ("values.compliance", "values.stiffness"),
        "expected its parameters compliance",
    ),
    "no such robot": (('"abb_irb120"', '"abb_irb999"'), "abb_irb999"),
    "neither scene nor recording": (("[scene]\n", "[test2]\n"), "is not known"),
    "a step that is none": (('["simulate"]', '["simulat"]'), "key do.1"),
    "compensate without calibrate": (
        ('["simulate"]', '["simulate", "compensate"]'),
        "calibrate before compensate",
    ),
    "no such model": (("seed = 3", 'seed = 3\nmodels = ["mine.toml"]'), "mine.toml"),
    "no runs": (("runs = 40", ""), "expected the number of runs of sobol, found none"),
    "a name twice": (
        ("[test]", f"[[vary.parameter]]\n{AXIS}\n[test]"),
        "expected names of parameters that differ",
    ),
    "tasks of another robot": (
        ("[test]", "[tasks]\njoints_deg = [[0, 0, 0]]\n[test]"),
        "expected 6 readings a pose",
    ),
    "not TOML": (("seed = 3", "seed = "), "found an unreadable file"),
    "saltelli of one": (('"sobol"', '"saltelli"'), "expected at least two parameters for saltelli"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_study_that_cannot_be_is_one_sentence(tmp_path, case):
    change, sentence = WRONG[case]
    path = scenes.written(tmp_path, change)
    with pytest.raises(InputError) as message:
        read(path)
    assert sentence in str(message.value), str(message.value)
    assert str(message.value).endswith(".") and "\n" not in str(message.value)


def refused(folder, *words, capsys):
    """The sentence of a call that ends with status 2, and that nothing but the study's file is in the folder."""
    before = {path.name for path in folder.iterdir()}
    assert run([str(word) for word in words]) == 2
    message = capsys.readouterr().err.strip()
    assert {path.name for path in folder.iterdir()} == before
    assert message and "\n" not in message and "Traceback" not in message
    return message


def test_the_command_ends_with_status_2_and_leaves_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = scenes.written(tmp_path, ("seed = 3", "seeds = 3"))
    assert "seeds" in refused(tmp_path, "study", path, capsys=capsys)
    assert "no such file" in refused(tmp_path, "study", tmp_path / "none.toml", capsys=capsys)
    text = scenes.TEXT[scenes.TEXT.index("[vary]") : scenes.TEXT.index("[[vary")]
    path.write_text(
        f'kind = "uncertainty"\nrecording = "not-there"\ndo = ["calibrate"]\n{text}'.replace(
            "sobol", "random"
        )
    )
    assert "not-there" in refused(tmp_path, "study", path, capsys=capsys)
    path = scenes.written(tmp_path)
    assert "expected one of the study's 40 runs" in refused(
        tmp_path, "study", path, "--run", 41, capsys=capsys
    )
    assert "found a folder" in refused(tmp_path, "study", path, "--json", tmp_path, capsys=capsys)


def test_a_full_disk_keeps_the_parts_that_are_whole_and_ends_in_one_sentence(tmp_path, monkeypatch):
    path, writes, write = scenes.written(tmp_path), [], Path.write_bytes

    def full(self, content):
        writes.append(self)
        if len(writes) == 4:
            write(self, b"half")
            raise OSError(errno.ENOSPC, "No space left on device", str(self))
        return write(self, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(InputError, match=": the disk is full. Free space"):
        carried_out(path, tmp_path / "out", 1, None, lambda line: None)
    kept = tmp_path / ".partial-out" / tables.PARTS_FOLDER
    assert not (tmp_path / "out").exists()
    assert len(list(kept.iterdir())) == 3 and all(
        pq.read_table(part).num_rows for part in kept.iterdir()
    )
    done = carried_out(path, tmp_path / "out", 1, None, lambda line: None)
    assert pq.read_table(done.path / tables.TABLE).column("run").to_pylist() == list(range(1, 41))


@pytest.mark.parametrize(
    "damage", [lambda b: b[:100], lambda b: b"", lambda b: b[:-9] + b"x" + b[-8:]]
)
def test_a_torn_part_is_computed_again(tmp_path, damage):
    """As after a loss of power; the damage was once found at the end of the study, without the name of a file."""
    path = scenes.written(tmp_path)

    def stop(line):
        if "15 of 40" in line or "18 of 40" in line:
            raise KeyboardInterrupt

    with pytest.raises(Stopped):
        carried_out(path, tmp_path / "out", 1, None, stop)
    parts = sorted((tmp_path / ".partial-out" / tables.PARTS_FOLDER).iterdir())
    parts[1].write_bytes(damage(parts[1].read_bytes()))
    done = carried_out(path, tmp_path / "out", 1, None, lambda line: None)
    found = pq.read_table(done.path / tables.TABLE)
    assert found.column("run").to_pylist() == list(range(1, 41))
    assert done.done.made >= 3


@pytest.mark.parametrize("left", ["parts/", ".partial-7-study.json"])
def test_a_kill_while_the_folder_is_created_does_not_stand_in_the_way(tmp_path, left):
    """The folder without the study's file was once taken for another interrupted study."""
    partial = tmp_path / ".partial-out"
    partial.mkdir()
    (partial / left).mkdir() if left.endswith("/") else (partial / left).write_text('{"dig')
    done = carried_out(scenes.written(tmp_path), tmp_path / "out", 1, None, lambda line: None)
    assert pq.read_table(done.path / tables.TABLE).num_rows == 40
    assert not [path.name for path in done.path.iterdir() if path.name.startswith(".")]


def test_a_disk_that_is_full_from_the_start_leaves_nothing(tmp_path, monkeypatch):
    whole = Path.open

    def full(self, mode="r", *given, **named):
        if "r" in mode:
            return whole(self, mode, *given, **named)
        raise OSError(errno.ENOSPC, "No space left on device", str(self))

    path = scenes.written(tmp_path)
    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(InputError, match="cannot be written"):
        carried_out(path, tmp_path / "a" / "out", 1, None, lambda line: None)
    assert [p.name for p in tmp_path.iterdir()] == ["small.toml"]
