"""Names of reflectors keep their identity from one recording to another."""

from dataclasses import replace

import pandas as pd
import pytest

import datasets
from datasets.samples.group_names import numbered_as
from robot_model import load_robot
from scenes import scene
from workbench.commands import cli
from workbench.core.errors import InputError
from workbench.files.solution_file import read_solution
from workbench.files.targets import read_programme
from workbench.jobs.robot.evaluate import evaluate

NAMES = {1: "SMR low", 2: "SMR high", 3: "SMR far"}


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """Two tables of one arm whose reflectors occur in another order, with names."""
    folder = tmp_path_factory.mktemp("names")
    assert cli.run(["new", "external-point", str(folder / "truth"), "--robot", "ur10"]) == 0
    table = pd.read_csv(folder / "truth" / "samples.csv", comment="#").drop(columns="sample")
    table["reflector"] = [NAMES[number] for number in table["reflector"]]
    first, second = table.iloc[:25], table.iloc[25:].iloc[::-1]
    assert first["reflector"].iloc[0] != second["reflector"].iloc[0]
    for name, part in (("first", first), ("second", second)):
        part.to_csv(folder / f"{name}.csv", index=False)
    return folder


def imported(tables, name):
    out = tables / f"{name}-recording"
    if not out.exists():
        call = ["import", str(tables / f"{name}.csv"), "--robot", "ur10"]
        assert cli.run([*call, "--out", str(out), "-y"]) == 0
    return datasets.read(out)


def test_an_import_keeps_the_names(tables):
    recording = imported(tables, "first")
    assert set(recording.group_names["reflector"]) == set(NAMES.values())
    written = pd.read_csv(recording.folder / "samples.csv")["reflector"]
    assert written.tolist() == pd.read_csv(tables / "first.csv")["reflector"].tolist()


def test_evaluation_takes_reflectors_by_name(tables, tmp_path):
    first, second = imported(tables, "first"), imported(tables, "second")
    assert first.group_names != second.group_names
    assert (
        cli.run(["calibrate", str(first.folder), "--out", str(tmp_path / "arm"), "--no-report"])
        == 0
    )
    found = evaluate(read_solution(tmp_path / "arm"), second)
    assert found.as_json()["error"]["rms_mm"] < 1.0


def test_numbers_follow_the_names():
    recording = scene("external-point", n=12, seed=3).recording
    recording = replace(recording, group_names={"reflector": tuple("bcdefgh")})
    same = numbered_as(recording, {"reflector": ["a", "b"]})
    assert same.group_names["reflector"] == tuple("abcdefgh")
    assert same.columns["reflector"].tolist() == (recording.columns["reflector"] + 1).tolist()
    untouched = numbered_as(recording, {})
    assert untouched.columns["reflector"].tolist() == recording.columns["reflector"].tolist()
    plain = replace(recording, group_names={})
    unchanged = numbered_as(plain, {"reflector": ["a", "b"]})
    assert unchanged.columns["reflector"].tolist() == plain.columns["reflector"].tolist()


def test_targets_may_have_names(tables, tmp_path):
    table = pd.read_csv(tables / "first.csv").filter(regex=r"^q\d_deg$").head(5)
    table["target"] = [f"t{k}" for k in range(5)]
    table.to_csv(tmp_path / "targets.csv", index=False)
    robot = load_robot({"builtin": "ur10"}, "robot")
    programme = read_programme(tmp_path / "targets.csv", robot)
    assert programme.table.columns["target"].tolist() == table["target"].tolist()
    assert programme.readings.shape == (5, 6)


def test_a_typing_error_in_a_known_column_is_still_named(tables, tmp_path):
    table = pd.read_csv(tables / "first.csv").filter(regex=r"^q\d_deg$").head(5).astype(object)
    table["payload_kg"] = ["2,5 kg"] * 5
    table.to_csv(tmp_path / "targets.csv", index=False)
    with pytest.raises(InputError, match="payload_kg"):
        read_programme(tmp_path / "targets.csv", load_robot({"builtin": "ur10"}, "robot"))
