"""Rows that stand twice in a table are named by the import, with their rows in the file."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.importers.mapping.model import Group, Mapping
from import_scenes import SCENE, UR10, degrees, simulated, write_rows
from workbench.recordings.importing import import_recording

HEADER = [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"]


def test_exact_copies_are_named_and_repeats_are_not(tmp_path):
    truth = simulated(tmp_path, SCENE)
    rows = np.column_stack([degrees(truth), truth.points])
    again = rows[20] + [0, 0, 0, 0, 0, 0, 0.01, -0.02, 0.01]  # measured twice
    path = write_rows(tmp_path / "t.csv", HEADER, [*rows[:8], rows[4], *rows[8:], again, rows[0]])
    made = import_recording([path], tmp_path / "out", UR10)
    (said,) = [text for text in made.suspicions if "exact copies" in text]
    assert said.startswith("2 rows are exact copies") and "(row 10 = 6, 40 = 2)" in said
    assert said in made.warnings
    plain = write_rows(tmp_path / "plain.csv", HEADER, [*rows, again])
    made = import_recording([plain], tmp_path / "plain", UR10)
    assert not any("exact cop" in text for text in made.suspicions)


def test_a_copied_row_of_several_reflectors_is_named_once(tmp_path):
    truth = simulated(tmp_path, SCENE)
    rows = np.column_stack([degrees(truth), truth.points, truth.points])
    turns = Rotation.from_quat(np.stack([truth.columns[f"q{axis}"] for axis in "xyzw"], axis=1))
    rows[:, 9:] += turns.apply([0.0, 120.0, 0.0])
    header = [*HEADER[:6], *(f"{axis}{ball} [mm]" for ball in (1, 2) for axis in "XYZ")]
    path = write_rows(tmp_path / "t.csv", header, [*rows[:8], rows[4], *rows[8:]])
    reflectors = {str(k): tuple(header[3 + 3 * k : 6 + 3 * k]) for k in (1, 2)}
    mapping = Mapping(point=Group(reflectors["1"], "mm"), reflectors=reflectors)
    made = import_recording([path], tmp_path / "out", replace(UR10, mapping=mapping))
    (said,) = [text for text in made.suspicions if "exact cop" in text]
    assert said.startswith("1 row is an exact copy") and "(row 10 = 6)" in said
