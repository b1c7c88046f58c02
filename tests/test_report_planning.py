"""Pages of `compare`, `poses`, `significance` and `identifiability`: one folder, figures, and the path as last line."""

import json
import re

import pytest

from workbench.commands.cli import run as run_command

CASES = {
    "identifiability": (
        ("identifiability", "elastic-arm"),
        ("stages", "precision", "joints", "space"),
    ),
    "significance": (("significance", "ur10", "--points", "5"), ("index-position", "sensitivity")),
    "poses": (("poses", "elastic-arm", "-n", "20"), ("space", "joints", "criterion")),
    "compare": (
        ("compare", "elastic-arm", "--plan", "ye-mdh", "--plan", "ye-2024", "--folds", "5"),
        ("errors-mm", "distribution-mm", "blocks", "pairs"),
    ),
}


@pytest.fixture(params=CASES, scope="module")
def made(request, tmp_path_factory):
    """Name of the command, its run folder and what it needs on the page."""
    arguments, figures = CASES[request.param]
    folder = tmp_path_factory.mktemp("runs") / request.param
    status = run_command([*arguments, "--out", str(folder)])
    assert status == 0
    return request.param, folder, figures


def test_the_page_shows_its_figures(made):
    _, folder, figures = made
    page = (folder / "report.html").read_text(encoding="utf-8")
    drawn = re.findall(r'<script type="application/json" data-for="([^"]+)">(.*?)</script>', page)
    assert {name for name, _ in drawn} >= set(figures)
    assert all(json.loads(data)["data"] for _, data in drawn)
    assert "nan" not in re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL).lower().split()


def test_the_folder_holds_the_answer(made):
    name, folder, _ = made
    assert json.loads((folder / "answer.json").read_text())["command"] == name


def test_the_indices_are_explained(made):
    name, folder, _ = made
    if name == "identifiability":
        assert "noise amplification index" in (folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["identifiability", "significance", "poses"])
def test_the_path_of_the_page_is_the_last_line(name, tmp_path, capsys):
    assert run_command([*CASES[name][0], "--out", str(tmp_path / "run")]) == 0
    assert capsys.readouterr().out.split()[-1] == str(tmp_path / "run" / "report.html")


def test_no_page_on_demand(tmp_path, capsys):
    arguments = (*CASES["significance"][0], "--no-report", "--out", str(tmp_path / "run"))
    assert run_command(list(arguments)) == 0
    assert not (tmp_path / "run" / "report.html").exists()
    assert capsys.readouterr().out.split()[-1] == str(tmp_path / "run")
