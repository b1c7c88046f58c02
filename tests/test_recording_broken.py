"""Every way that we know of to break a recording, and the sentence that it must get.

Each case is one patch of a good recording; its sentence must be one line that holds the file, the
row or key, and what to do. After the table, property-based tests break recordings at random:
nothing but InputError may come out.
"""

import os

import cv2
import numpy as np
import pytest

import datasets
from broken_recordings import (
    CSV,
    IMG,
    ROBOT,
    TOML,
    Case,
    assert_sentence,
    both,
    drop,
    link_outside,
    remove,
    sub,
    truncate_image,
    write,
)
from broken_tables import TABLES
from datasets.errors import InputError
from good_recordings import write_good

CASES = [
    # recording.toml
    Case("no recording.toml", remove(TOML), (TOML, "found only other files", "workbench import")),
    Case("empty recording.toml", write(TOML, b""), (TOML, "empty file", "export it again")),
    Case("broken TOML", sub(TOML, r'"test"', '"test'), (TOML, "line 2", "correct that line")),
    Case("binary recording.toml", write(TOML, b"\xff\xfe\x00binary"), (TOML, "byte 1", "UTF-8")),
    Case("no format", sub(TOML, r"^format.*\n", ""), (TOML, "key format", "add format")),
    Case(
        "unknown format",
        sub(TOML, "recording/1", "recording/9"),
        (TOML, "key format", "recording/9", "correct"),
    ),
    Case("no measures", sub(TOML, r"^measures.*\n", ""), (TOML, "key measures", "add measures")),
    Case(
        "unknown measures",
        sub(TOML, "ball-centre", "ball-center"),
        (TOML, "key measures", "'ball-center'", "ball-surface"),
    ),
    Case(
        "misspelt key", sub(TOML, "measures", "measure"), (TOML, "key measures", "rename measure")
    ),
    Case("sigma_mm zero", sub(TOML, "0.02", "0.0"), (TOML, "key sigma_mm", "above 0", "correct")),
    Case(
        "sigma_mm negative", sub(TOML, "0.02", "-0.02"), (TOML, "key sigma_mm", "-0.02", "correct")
    ),
    Case(
        "sigma_mm as text", sub(TOML, "0.02", '"0.02"'), (TOML, "key sigma_mm", "'0.02'", "correct")
    ),
    Case("sigma_mm not finite", sub(TOML, "0.02", "inf"), (TOML, "key sigma_mm", "inf", "correct")),
    Case(
        "sigma without unit",
        sub(TOML, "sigma_mm", "sigma"),
        (TOML, "key sigma", "rename it to sigma_mm"),
    ),
    Case(
        "no [samples]",
        sub(TOML, r"\[samples\]\nfile.*\n", ""),
        (TOML, "key [samples]", "add [samples]"),
    ),
    Case("no [robot]", sub(TOML, r"\[robot\]\nfile.*\n", ""), (TOML, "key [robot]", "add [robot]")),
    Case(
        "no [artefact]",
        sub(TOML, r"\[artefact\]\nfile.*\n", ""),
        (TOML, "key [artefact]", "artefact.csv"),
    ),
    Case(
        "robot is a word",
        sub(TOML, r"\[robot\]\nfile.*\n", 'robot = "x"\n'),
        (TOML, "key robot", "table", "correct"),
    ),
    Case(
        "file key missing",
        sub(TOML, r'file = "samples.csv"', "other = 1"),
        (TOML, "[samples]", "key file", "add file"),
    ),
    Case(
        "path leaves the folder",
        sub(TOML, "samples.csv", "../samples.csv"),
        (TOML, "samples.file", "leaves it", "copy"),
    ),
    Case(
        "absolute path",
        sub(TOML, "samples.csv", "/data/samples.csv"),
        (TOML, "samples.file", "absolute", "copy"),
    ),
    Case(
        "Windows path",
        sub(TOML, '"samples.csv"', "'C:\\\\data\\\\samples.csv'"),
        (TOML, "samples.file", "absolute", "copy"),
    ),
    Case(
        "backslash",
        sub(TOML, '"samples.csv"', "'data\\\\samples.csv'"),
        (TOML, "samples.file", "forward slashes", "write /"),
    ),
    Case("link leaves the folder", link_outside, (TOML, "samples.file", "leaves it", "copy")),
    Case(
        "samples is a folder",
        both(remove(CSV), lambda f: (f / CSV).mkdir()),
        (CSV, "a folder", "correct the name"),
    ),
    Case(
        "robot of unknown ending",
        sub(TOML, "robot.toml", "robot.json"),
        (TOML, "robot.file", ".urdf", "name one"),
    ),
    Case(
        "unknown ending",
        sub(TOML, "samples.csv", "samples.xlsx"),
        ("samples.xlsx", ".parquet", "save it"),
    ),
    Case(
        "unknown board",
        sub(TOML, "chessboard", "checkers"),
        (TOML, "[board]", "kind", "charuco", "correct"),
        "board-images",
    ),
    Case(
        "square of size zero",
        sub(TOML, "5.0", "0"),
        (TOML, "square_mm", "above 0", "correct"),
        "board-images",
    ),
    Case(
        "half a row of corners",
        sub(TOML, "rows = 8", "rows = 8.5"),
        (TOML, "key rows", "8.5", "correct"),
        "board-images",
    ),
    Case(
        "no [board]",
        sub(TOML, r"\[board\](.|\n)*", ""),
        (TOML, "key [board]", "add [board]"),
        "board-images",
    ),
    # robot.toml
    Case("no robot.toml", remove(ROBOT), (ROBOT, "no such file", "put it there")),
    Case(
        "robot without joints",
        write(ROBOT, b'name = "x"\nconvention = "distal"'),
        (ROBOT, "key joint", "add joint"),
    ),
    Case(
        "unknown convention",
        sub(ROBOT, "distal", "proximal"),
        (ROBOT, "key convention", "'proximal'", "correct"),
    ),
    Case(
        "gravity not unit", sub(ROBOT, "-1.0", "-9.81"), (ROBOT, "key gravity", "unit", "correct")
    ),
    Case(
        "joint without alpha",
        sub(ROBOT, r"alpha_deg = -90\n", ""),
        (ROBOT, "joint 1", "alpha_deg", "add alpha_deg"),
    ),
    Case(
        "joint with another unit",
        sub(ROBOT, "a_mm", "a_m"),
        (ROBOT, "joint 1", "key a_m ", "rename it to a_mm"),
    ),
    Case(
        "length as text",
        sub(ROBOT, "d_mm = 330", 'd_mm = "330"'),
        (ROBOT, "joint 1", "d_mm", "correct"),
    ),
    Case(
        "angle not finite",
        sub(ROBOT, "theta_deg = -90", "theta_deg = nan"),
        (ROBOT, "joint 2", "theta_deg", "correct"),
    ),
    Case(
        "robot in radians",
        sub(ROBOT, "alpha_deg = -90", "alpha_deg = -1.5708"),
        (ROBOT, "joint 1", "alpha_deg", "write -90"),
    ),
    Case(
        "robot in metres",
        both(*(sub(ROBOT, f"= {v}$", f"= {v / 1000}") for v in (330, 330, 50, 35, -335, -80))),
        (ROBOT, "a_mm", "metres", "multiply"),
    ),
    Case(
        "limits reversed",
        sub(ROBOT, r"\[-190, 190\]", "[190, -190]"),
        (ROBOT, "joint 1", "limits_deg", "swap"),
    ),
    Case(
        "limits of a joint that stands still",
        sub(ROBOT, r"\[-190, 190\]", "[0, 0]"),
        (ROBOT, "joint 1", "limits_deg", "remove the key limits_deg"),
    ),
    Case(
        "sign is two",
        sub(ROBOT, "hayati = false", "hayati = false\nsign = 2"),
        (ROBOT, "joint 1", "sign", "correct"),
    ),
    Case(
        "hayati is a word",
        sub(ROBOT, "hayati = false", 'hayati = "no"'),
        (ROBOT, "joint 1", "hayati", "correct"),
    ),
    Case(
        "coupled to no joint",
        sub(ROBOT, "joint = 2", "joint = 9"),
        (ROBOT, "joint 3", "coupled", "name the joint"),
    ),
    Case(
        "negative mass",
        sub(ROBOT, "hayati = false", "hayati = false\nmass_kg = -3"),
        (ROBOT, "mass_kg", "-3", "correct"),
    ),
    Case(
        "gear ratio zero",
        sub(ROBOT, "hayati = false", "hayati = false\ngear_ratio = 0"),
        (ROBOT, "gear_ratio", "correct"),
    ),
    Case(
        "URDF that breaks off",
        both(write("robot.urdf", b"<robot><link"), sub(TOML, "robot.toml", "robot.urdf")),
        ("robot.urdf", "breaks off", "export it again"),
    ),
    Case(
        "URDF without the joint",
        both(
            write("robot.urdf", b"<robot><joint name='a'/></robot>"),
            sub(TOML, '"robot.toml"', '"robot.urdf"\njoints = ["b"]'),
        ),
        ("robot.urdf", "joints", "'b'", "correct"),
    ),
    # images
    Case("no images.csv", remove(IMG), (IMG, "no such file", "put it there"), "scan-images"),
    Case(
        "image missing",
        remove("images/a.png"),
        (IMG, "row 2", "images/a.png", "no such file", "correct the name"),
        "scan-images",
    ),
    Case(
        "image empty",
        write("images/c.png", b""),
        (IMG, "row 4", "images/c.png", "empty", "export"),
        "scan-images",
    ),
    Case(
        "image truncated",
        truncate_image,
        (IMG, "row 3", "images/b.png", "no end", "copy it again"),
        "scan-images",
    ),
    Case(
        "image without a header",
        write("images/a.png", b"\x89PNG\r\n\x1a\n" + bytes(99)),
        (IMG, "images/a.png", "broken header", "copy it again"),
        "scan-images",
    ),
    Case(
        "image is text",
        write("images/a.png", b"no image at all"),
        (IMG, "row 2", "images/a.png", "PNG", "save it"),
        "scan-images",
    ),
    Case(
        "image elsewhere",
        sub(IMG, "images/a.png", "../a.png"),
        (IMG, "row 2", "image", "leaves it", "copy"),
        "scan-images",
    ),
    Case(
        "unknown role",
        sub(IMG, "board-laser", "laser"),
        (IMG, "row 3", "role", "'laser'", "write one"),
        "scan-images",
    ),
    Case(
        "laser image of no place",
        sub(IMG, "board-laser,1", "board-laser,"),
        (IMG, "row 3", "placement", "add a placement"),
        "scan-images",
    ),
    Case("no role column", drop("role", IMG), (IMG, "column role", "add it"), "scan-images"),
]


def test_table_is_long_and_names_are_unique():
    every = CASES + TABLES
    assert len(every) >= 45
    assert len({case.name for case in every}) == len(every)


@pytest.mark.parametrize("case", CASES + TABLES, ids=lambda case: case.name)
def test_broken_recording_gets_its_sentence(tmp_path, case):
    assert_sentence(write_good(tmp_path / "cell-4", case.measures), case)


def test_folder_that_is_not_there_names_the_command_that_lists_known_ones():
    with pytest.raises(InputError, match="no-such-recording.*`workbench datasets`"):
        datasets.read("no-such-recording")


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read everything"
)
def test_file_without_permission(tmp_path):
    folder = write_good(tmp_path / "cell-4")
    (folder / CSV).chmod(0)
    with pytest.raises(InputError, match="read permission"):
        datasets.read(folder)


def test_image_of_another_kind_is_left_to_opencv(tmp_path):
    folder = write_good(tmp_path / "cell-4", "board-images")
    cv2.imwrite(str(folder / "images" / "a.tiff"), np.zeros((5, 6), np.uint8))
    sub(IMG, "images/a.png", "images/a.tiff")(folder)
    assert datasets.read(folder).images[0]["image"] == "images/a.tiff"
