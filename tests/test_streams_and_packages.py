"""Closed pipes, closed descriptors and full disks on standard output; packages that are not installed."""

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path

import pytest

from conftest import ROOT, mostly_slow
from workbench.machine import doctor


def shell(line: str, folder: Path, **environment) -> subprocess.CompletedProcess:
    """A line of bash in which `workbench` is this checkout's, with the exit status of its first command."""
    called = f'workbench() {{ "{sys.executable}" -m workbench "$@"; }}; set -o pipefail; {line}'
    path = os.pathsep.join(filter(None, (environment.pop("first", ""), str(ROOT))))
    environment = {**os.environ, "PYTHONPATH": path, **environment}
    return subprocess.run(
        ["bash", "-c", called],
        cwd=folder,
        text=True,
        capture_output=True,
        env=environment,
        check=False,
    )


@pytest.mark.parametrize(
    "line",
    [
        "--help | head -1",
        "--version >&-",
        "datasets list | head -1",
        "datasets list >&-",
        "--help 2>&-",
        "datasets list --json - | head -c 10",
        "datasets list >&- 2>&- <&-",
        "--help | true",
    ],
)
def test_a_reader_that_goes_away_changes_no_exit_status(line, tmp_path):
    done = shell(f"workbench {line}", tmp_path)
    assert done.returncode == 0, done.stderr
    assert (
        "Traceback" not in done.stderr
        and "Exception ignored" not in done.stderr
        and "bug" not in done.stderr
    )


@pytest.mark.parametrize(
    "end", mostly_slow(["| head -1", "| true", ">&-", ">&- 2>&-", "2>&1 | head -1"], 0, 3)
)
def test_the_result_is_kept_when_nobody_reads(end, tmp_path):
    done = shell(f"workbench significance ur10e --out run {end}", tmp_path)
    assert done.returncode == 0, done.stderr
    answer = json.loads((tmp_path / "run" / "answer.json").read_text(encoding="utf-8"))
    assert answer["command"] == "significance"
    assert all(
        (tmp_path / "run" / name).stat().st_size for name in ("table.csv", "significance.png")
    )


@pytest.mark.parametrize("end", ["| head -1", ">&-", "2>&1 | true"])
def test_an_answer_that_is_no_or_a_wrong_call_keeps_its_status(end, tmp_path):
    done = shell(f"workbench calibrate no-such-recording {end}", tmp_path)
    assert done.returncode == 2


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_an_answer_that_cannot_be_written_is_a_sentence_and_status_2(tmp_path):
    done = shell("workbench datasets list --json - > /dev/full", tmp_path)
    assert done.returncode == 2
    last = done.stderr.strip().splitlines()[-1]
    assert (
        "Standard output cannot be written, because the system says 'No space left on device'"
        in last
    )
    assert "Traceback" not in done.stderr


def without(packages: Iterable[str], folder: Path) -> str:
    """A folder for PYTHONPATH in which the packages are there and say that they are not installed."""
    for package in packages:
        place = folder / "without" / package
        place.mkdir(parents=True)
        (place / "__init__.py").write_text(
            f'raise ModuleNotFoundError("No module named {package!r}", name="{package}")\n'
        )
    return str(folder / "without")


def test_a_study_without_salib_is_one_sentence(tmp_path):
    done = shell(
        "workbench study uncertainty-sources --workers 1",
        tmp_path,
        first=without(["SALib"], tmp_path),
    )
    assert done.returncode == 2 and len(done.stderr.strip().splitlines()) == 1
    assert "The package SALib is not installed" in done.stderr
    assert "pip install 'vision-sensor-workbench[study]'" in done.stderr
    assert not (tmp_path / "runs").exists()


MISSING = [["mujoco"], pytest.param(list(doctor.OPTIONAL), marks=pytest.mark.slow)]


@pytest.mark.parametrize("names", MISSING, ids=["one", "all"])
def test_the_doctor_names_the_commands_that_need_missing_packages(names, tmp_path):
    done = shell(
        "workbench doctor --json answer.json",
        tmp_path,
        first=without(names, tmp_path),
        COLUMNS="500",
    )
    assert done.returncode == 0, done.stderr
    checks = {
        check["name"]: check
        for check in json.loads((tmp_path / "answer.json").read_text())["checks"]
    }
    assert f"Optional packages are missing: {', '.join(names)};" in done.stdout
    for name in names:
        extra = doctor.OPTIONAL[name]
        assert not checks[name]["ok"] and not checks[name]["required"]
        assert extra.needs in checks[name]["advice"] and extra.command in checks[name]["advice"]
        assert extra.command in done.stdout


@pytest.mark.parametrize("package", ["pydantic", "pyarrow"])
def test_a_required_package_that_is_missing_is_a_sentence(package):
    error = ModuleNotFoundError(f"No module named '{package}'", name=package)
    assert f"pip install {package}" in doctor.missing_package(error)


def test_only_packages_and_system_libraries_are_blamed():
    assert (
        doctor.missing_package(
            ImportError("cannot import name 'x' from 'workbench'", name="workbench")
        )
        is None
    )
    assert (
        doctor.missing_package(
            ModuleNotFoundError("No module named 'workbench.x'", name="workbench.x")
        )
        is None
    )
    assert "libgl1" in doctor.missing_package(
        ImportError("libGL.so.1: cannot open shared object file", name="cv2")
    )


def distributions(lines) -> set[str]:
    return {re.match(r"[A-Za-z0-9_-]+", line)[0] for line in lines}


def test_the_doctor_looks_at_every_dependency_of_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {name for brings in doctor.LIBRARIES.values() for name in brings} == distributions(
        project["dependencies"]
    )
    required = distributions(project["dependencies"])
    for extra in ("proof", "study"):
        listed = distributions(project["optional-dependencies"][extra]) - required
        assert {
            one.distribution for one in doctor.OPTIONAL.values() if one.extra == extra
        } == listed
