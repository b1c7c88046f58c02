"""Rotations and objects in the words of a laboratory, columns that a proposed mapping omits, and the user's own columns."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.columns.sets import find_sets
from datasets.importers.mapping.joined_tables.time_stamps import times_of
from datasets.importers.mapping.left_out import left_out_sentences, unused_rotation_sentences
from datasets.importers.mapping.proposal import propose
from datasets.importers.source import ImageFile, RawTable
from datasets.importers.sources.choice import read_sources
from datasets.importers.sources.tables.text_tables import numbers_from_text
from import_scenes import SCENE, UR10, degrees, simulated, write_rows
from workbench.commands.data import import_dialogue
from workbench.core.errors import InputError
from workbench.recordings.importing import import_recording
from workbench.recordings.importing.board_images.image_rows import file_link
from workbench.recordings.importing.user_columns import in_user_columns


def table_of(*names, texts=()):
    cells = {name: np.arange(5.0) + k for k, name in enumerate(names)}
    cells |= {name: np.array([f"image_{k}.png" for k in range(5)]) for name in texts}
    return RawTable("poses.txt", cells, np.arange(5) + 2)


@pytest.mark.parametrize(
    "header",
    [
        *("Giro X", "Orientación X", "Rotación X [°]", "Rotazione X", "Orientamento X"),
        *("Rotação X", "Rotation X", "Drehung um X", "旋转X", "回転X", "姿勢 X"),
    ],
)
def test_a_rotation_is_known_by_its_word(header):
    found = read_header(header)
    assert (found.kind, found.label) == ("turn", "x")


@pytest.mark.parametrize(
    "header",
    [
        *("X brida", "X de la brida", "X bride", "X flangia", "X (mm) brida", "X flange [mm]"),
        *("Posición X de la brida", "flange X", "X of the flange", "法兰X"),
    ],
)
def test_the_object_may_stand_behind_the_component(header):
    found = read_header(header)
    assert (found.kind, found.label, found.words) == ("xyz", "x", ("flange",))


@pytest.mark.parametrize("rotation", ["Giro {}", "R{} brida", "Orientación {}"])
def test_a_pose_of_the_flange_is_complete_with_its_rotation(rotation):
    names = [rotation.format(axis) for axis in "XYZ"]
    table = table_of("X brida", "Y brida", "Z brida", *names, texts=["Imagen"])
    mapping = propose(table, has_images=True).mapping
    assert mapping.flange_rotation.columns == tuple(names)
    assert left_out_sentences(table, mapping, has_images=True) == ()


def test_a_pose_without_a_rotation_and_unknown_columns_are_said():
    names = ["Kierto X", "Kierto Y", "Kierto Z"]
    table = table_of("Brida X", "Brida Y", "Brida Z", *names)
    said = left_out_sentences(table, propose(table, has_images=True).mapping, has_images=True)
    assert "has no rotation" in said[0] and "[flange_rotation]" in said[0]
    assert "'Kierto X', 'Kierto Y', 'Kierto Z'" in said[1]


@pytest.mark.parametrize("names", [("ax", "ay", "az"), ("i", "j", "k"), ("Zx", "Zy", "Zz")])
@pytest.mark.parametrize("decimals", [2, 6])
def test_unit_vectors_are_offered_as_a_measured_axis(names, decimals):
    vectors = np.random.default_rng(4).normal(size=(3, 5))
    axis = np.round(vectors / np.linalg.norm(vectors, axis=0), decimals)
    table = table_of("A1", "A2", "A3", "X", "Y", "Z", *names)
    table = replace(table, columns={**table.columns, **dict(zip(names, axis))})
    (said,) = left_out_sentences(table, propose(table).mapping, has_images=False)
    assert f'[axis] columns = ["{names[0]}", "{names[1]}", "{names[2]}"]' in said
    longer = replace(table, columns={**table.columns, names[0]: axis[0] + 0.5})
    said = left_out_sentences(longer, propose(longer).mapping, has_images=False)
    assert not any("[axis]" in text for text in said)


def test_a_rotation_that_no_point_takes_is_said():
    table = table_of("A1", "A2", "A3", "Tracker X", "Tracker Y", "Tracker Z", "phi", "theta", "psi")
    mapping = propose(table).mapping
    without = replace(mapping, rotation=None)
    assert mapping.rotation is not None and unused_rotation_sentences(table, mapping) == ()
    (said,) = unused_rotation_sentences(table, without)
    assert "'phi', 'theta', 'psi' are a rotation" in said


def test_a_remark_in_brackets_is_no_part_of_the_component():
    for header, kind in (("Z (calibrated)", "xyz"), ("Axis 3 (measured)", "joint")):
        assert read_header(header).kind == kind
    for header in ("X [mm/s]", "J1 [Nm]", "J1 [A]", "J1 [rpm]"):
        assert read_header(header).kind in ("", "sample"), header


@pytest.mark.parametrize("name", ["pouces", "pollici", "pulgadas", "polegadas", "英寸", "インチ"])
def test_inches_are_known_in_other_languages(name):
    found = read_header(f"X ({name})")
    assert (found.kind, found.unit) == ("xyz", "in")


@pytest.mark.parametrize(
    "names",
    [
        ("e0", "e1", "e2", "e3"),
        ("q_scalar", "q_vec_x", "q_vec_y", "q_vec_z"),
        ("quat_real", "quat_x", "quat_y", "quat_z"),
    ],
)
def test_names_of_quaternions(names):
    half = np.deg2rad(np.arange(5.0) * 10)
    cells = dict(zip(names, (np.cos(half), np.sin(half), 0 * half, 0 * half), strict=True))
    (found,) = find_sets(RawTable("t.csv", cells, np.arange(5)))
    assert (found.kind, found.names) == ("quaternion", names)


def test_the_axes_of_a_motoman_do_not_hide_other_words():
    names = [*"SLURBT", "phi", "theta", "psi"]
    found = find_sets(table_of(*names))
    assert {one.names for one in found} == {tuple("SLURBT"), ("phi", "theta", "psi")}


def test_the_angles_o_a_t_of_kawasaki_are_a_rotation_and_no_time():
    """T alone, next to x, y and z, is the time."""
    names = [*"XYZOAT"]
    table = RawTable("a.csv", {name: np.linspace(0, 9, 5) for name in names}, np.arange(5))
    assert {one.names for one in find_sets(table)} == {tuple("XYZ"), tuple("OAT")}
    assert times_of(table)[0] is None
    columns = {name: table.columns[name] for name in "XYZT"}
    assert times_of(RawTable("a.csv", columns, np.arange(5)))[1] == ("T",)


@pytest.mark.parametrize(
    ("header", "kind", "is_nominal"),
    [("X Ist [mm]", "xyz", False), ("Y Soll", "xyz", True), ("J1 actual", "joint", False)],
)
def test_actual_and_nominal_may_stand_behind_the_component(header, kind, is_nominal):
    found = read_header(header)
    assert (found.kind, found.is_nominal) == (kind, is_nominal)


def test_covariates_by_the_names_of_the_format_are_kept():
    joints = [f"q{k}_deg" for k in range(1, 7)]
    own = ["approach3", "qdot2_deg_s", "current1_a", "torque6_nm", "temperature_c"]
    own += ["temperature_j2_c", "payload_kg"]
    made = propose(table_of(*joints, "x_mm", "y_mm", "z_mm", *own, "Strom"))
    assert {name: made.mapping.columns[name] for name in own} == dict(zip(own, own))
    assert made.unused == ("Strom",)
    assert read_header("Lufttemp. [°C]").kind == "temperature_c"


def test_spaces_and_quotes_group_thousands():
    cells = ["1 234,5", "-12\u00a0345,25", "7,0", "1\u2009000\u2009000,5"]
    made = numbers_from_text(cells, "t.csv, column X", [2, 3, 4, 5])
    assert made.tolist() == [1234.5, -12345.25, 7.0, 1000000.5]


def test_objects_inside_records_are_columns(tmp_path):
    rows = [{"q": [0.1 * k, 0.2, 0.3], "tracker": {"x": k, "y": 2.0, "z": 3.0}} for k in range(6)]
    path = tmp_path / "t.json"
    path.write_text(json.dumps(rows))
    (table,) = read_sources([path], tmp_path).tables
    assert propose(table).mapping.point.columns == ("tracker x", "tracker y", "tracker z")


def test_propose_prints_and_writes_omitted_columns(workbench, tmp_path):
    header = [
        "A1",
        "A2",
        "A3",
        "Messpunkt X",
        "Messpunkt Y",
        "Messpunkt Z",
        "Kulma X",
        "Kulma Y",
        "Kulma Z",
    ]
    write_rows(tmp_path / "t.csv", header, np.random.default_rng(1).normal(size=(6, 9)))
    done = workbench("import", "t.csv", "--propose", "map.toml")
    assert done.returncode == 0
    for text in (done.stdout, (tmp_path / "map.toml").read_text()):
        assert "'Kulma X', 'Kulma Y', 'Kulma Z'" in " ".join(text.split())


def test_a_file_that_is_not_there_is_one_short_sentence(workbench):
    done = workbench("check", "nosuch")
    assert done.returncode == 2
    assert "workbench datasets" in done.stderr and "irb120" not in done.stderr


def test_the_column_with_the_names_of_the_images_is_named(tmp_path):
    images = [ImageFile(tmp_path / f"image_{k}.png", f"image_{k}.png") for k in range(5)]
    assert file_link(images, table_of("X", texts=["Foto"])) == (("Foto",), "names of the files")
    assert file_link(images, table_of("X"))[0] == ()


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def own_table(path, truth, readings, header):
    times = [f"{k}.5" for k in range(len(readings))]
    rows = [[t, *q, *p] for t, q, p in zip(times, readings, truth.points, strict=True)]
    return write_rows(path, ["Hora", *header, "Punto X", "Punto Y", "Punto Z"], rows)


def test_a_mistake_is_named_by_the_header_of_the_user(tmp_path, truth):
    """Readings in rad, whose unit nothing states, with one reversed joint."""
    readings = np.deg2rad(degrees(truth)) * [1, 1, -1, 1, 1, 1]
    path = own_table(tmp_path / "log.csv", truth, readings, [f"Eje {k}" for k in range(1, 7)])
    with pytest.raises(InputError, match=r"^log.csv, column 'Eje 3'.*opposite sign") as refused:
        import_recording([path], tmp_path / "out", UR10)
    assert not re.search(r"q\d_deg|samples\.csv", str(refused.value))


def test_the_preview_names_the_column_of_the_times(tmp_path, truth):
    from rich.console import Console

    header = [f"Eje {k}" for k in range(1, 7)]
    path = own_table(tmp_path / "log.csv", truth, degrees(truth), header)
    made = import_recording([path], tmp_path / "out", UR10)
    assert made.links["time"]["columns"] == ["Hora"]
    console = Console(record=True, width=120, file=open("/dev/null", "w"))
    import_dialogue.show(console, made.as_json(), made)
    assert re.search(r"time +Hora", console.export_text())


def test_sentences_on_other_files_keep_their_words(truth):
    from datasets.importers.mapping.model import Group, Mapping

    mapping = Mapping(joints=Group(("A1", "A2"), "deg"))
    named = in_user_columns("samples.csv of recording 'x', column q2_deg: bad.", "t.csv", mapping)
    assert named == "t.csv, column 'A2': bad."
    other = "robot file of recording 'x': q2_deg."
    assert in_user_columns(other, "t.csv", mapping) == other
