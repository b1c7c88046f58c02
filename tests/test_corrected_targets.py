"""Targets that are corrected already are recognised: a second correction would move the arm off by the first one."""

from pathlib import Path

import numpy as np
import pytest

from export_scenes import arm_with
from scenes import ABB
from workbench.core.errors import InputError
from workbench.files.corrected_targets import check_uncorrected
from workbench.files.exports.programs import Program, program_text
from workbench.files.targets import as_csv, corrected_columns, read_programme
from workbench.jobs.robot.compensation.compensate import compensate

ARM = arm_with(ABB, (), values={f"tool.{c}": 40.0 for c in "xyz"})
READINGS_DEG = np.array([[0.0, 10, 10, 20, 30, 40], [20.0, -10, 15, 10, 40, 5]])


def own_targets(folder: Path, names: list[str]) -> Path:
    path = folder / "targets.csv"
    rows = [",".join(names), *(",".join(map(str, row)) for row in READINGS_DEG)]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("header", ["q{}_deg", "Achse {} [deg]"])
def test_a_corrected_table_is_recognised(header, tmp_path):
    path = own_targets(tmp_path, [header.format(k) for k in range(1, 7)])
    programme = read_programme(path, ARM.robot)
    check_uncorrected(programme, path)
    corrected = tmp_path / "corrected.csv"
    found = compensate(ARM, programme.readings)
    corrected.write_text(as_csv(corrected_columns(programme, ARM.robot, found)), encoding="utf-8")
    with pytest.raises(InputError, match="not yet corrected, found the columns correction_mm"):
        check_uncorrected(read_programme(corrected, ARM.robot), corrected)


@pytest.mark.parametrize(("language", "ending"), [("krl", "src"), ("rapid", "mod")])
def test_a_corrected_program_is_recognised(language, ending, tmp_path):
    path = tmp_path / f"part.{ending}"
    program = Program(np.deg2rad(READINGS_DEG), "part", ARM.robot.name, 0.08)
    path.write_text(program_text(program, language), encoding="utf-8")
    programme = read_programme(path, ARM.robot)
    np.testing.assert_allclose(np.rad2deg(programme.readings), READINGS_DEG, atol=1e-6)
    with pytest.raises(InputError, match="--force to correct these once more"):
        check_uncorrected(programme, path)
