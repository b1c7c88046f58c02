"""Every way that we know of to break a recording, and the sentence that it must get.

Each case is one patch of a good recording; its sentence must be one line that holds the file, the
row or key, and what to do. After the table, property-based tests break recordings at random:
nothing but InputError may come out.
"""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

import datasets
from datasets.errors import InputError
from test_recording_good import write_good


@dataclass(frozen=True)
class Case:
    """A name, what is done to the folder, and words that the sentence must hold."""

    name: str
    patch: Callable[[Path], None]
    words: tuple[str, ...]
    measures: str = "ball-centre"


def sub(file: str, old: str, new: str) -> Callable[[Path], None]:
    """Replace the first match of the regular expression `old`, which must be there."""

    def patch(folder: Path) -> None:
        text = (folder / file).read_text(encoding="utf-8")
        assert re.search(old, text, re.M), (file, old)
        (folder / file).write_text(re.sub(old, new, text, count=1, flags=re.M), encoding="utf-8")

    return patch


def cell(row: int, column: str, value: str, file: str = "samples.csv") -> Callable[[Path], None]:
    """Put `value` into one cell; the header is row 1."""
    return lambda folder: edit(
        folder, file, lambda rows: rows[row - 1].__setitem__(rows[0].index(column), value)
    )


def column(
    name: str, change: Callable[[str], str], new: str = "", file: str = "samples.csv"
) -> Callable[[Path], None]:
    """Change every cell of the columns that match `name`, and the header to `new` where given."""

    def patch(rows: list[list[str]]) -> None:
        for k, header in enumerate(rows[0]):
            if re.fullmatch(name, header):
                for row in rows[1:]:
                    row[k] = change(row[k])
                rows[0][k] = re.sub(name, new, header) if new else header

    return lambda folder: edit(folder, file, patch)


def drop(name: str, file: str = "samples.csv") -> Callable[[Path], None]:
    """Delete one column."""

    def patch(rows: list[list[str]]) -> None:
        k = rows[0].index(name)
        for row in rows:
            del row[k]

    return lambda folder: edit(folder, file, patch)


def numbered(name: str) -> Callable[[Path], None]:
    """Another number in every row of one column."""
    return lambda folder: edit(
        folder,
        "samples.csv",
        lambda rows: [
            row.__setitem__(rows[0].index(name), str(k)) for k, row in enumerate(rows[1:])
        ],
    )


def add(name: str, value: str) -> Callable[[Path], None]:
    """A further column of samples.csv with one value in every row."""
    return lambda folder: edit(
        folder,
        "samples.csv",
        lambda rows: [r.append(name if r is rows[0] else value) for r in rows],
    )


def edit(folder: Path, file: str, change: Callable[[list[list[str]]], None]) -> None:
    rows = [line.split(",") for line in (folder / file).read_text(encoding="utf-8").splitlines()]
    change(rows)
    (folder / file).write_text("\n".join(map(",".join, rows)) + "\n", encoding="utf-8")


def write(file: str, content: bytes) -> Callable[[Path], None]:
    return lambda folder: bool((folder / file).write_bytes(content))


def remove(file: str) -> Callable[[Path], None]:
    return lambda folder: (folder / file).unlink()


def every_line(change: Callable[[str], str]) -> Callable[[Path], None]:
    """Change the whole text of samples.csv."""
    return lambda folder: bool(
        (folder / "samples.csv").write_text(change((folder / "samples.csv").read_text()))
    )


def both(*patches: Callable[[Path], None]) -> Callable[[Path], None]:
    return lambda folder: [patch(folder) for patch in patches]


def radians(text: str) -> str:
    return str(np.deg2rad(float(text)))


def thousandth(text: str) -> str:
    return str(float(text) / 1000)


def ten_gigabytes(folder: Path) -> None:
    with (folder / "samples.csv").open("wb") as file:
        file.truncate(10 * 10**9)


def truncate_image(folder: Path) -> None:
    path = folder / "images" / "b.png"
    path.write_bytes(path.read_bytes()[:-20])


def parquet(**columns) -> Callable[[Path], None]:
    def patch(folder: Path) -> None:
        pyarrow.parquet.write_table(pyarrow.table(columns), folder / "samples.parquet")
        sub("recording.toml", "samples.csv", "samples.parquet")(folder)

    return patch


def link_outside(folder: Path) -> None:
    (folder.parent / "elsewhere.csv").write_text("sample\n1\n")
    (folder / "samples.csv").unlink()
    (folder / "samples.csv").symlink_to(folder.parent / "elsewhere.csv")


TOML, ROBOT, CSV, ART, IMG = (
    "recording.toml",
    "robot.toml",
    "samples.csv",
    "artefact.csv",
    "images.csv",
)
Q = r"q\d_deg"
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
    # samples.csv, the table
    Case("no samples.csv", remove(CSV), (CSV, "no such file", "put it there")),
    Case("empty samples.csv", write(CSV, b""), (CSV, "empty file", "export it again")),
    Case(
        "only a header",
        every_line(lambda t: t.splitlines()[0]),
        (CSV, "at least one row", "record samples"),
    ),
    Case("only blanks", write(CSV, b" , \n\n"), (CSV, "header row", "export it again")),
    Case("ten gigabytes", ten_gigabytes, (CSV, "at most 256 MB", "10000 MB", "split")),
    Case(
        "UTF-16",
        every_line(lambda t: t)
        and (lambda f: bool((f / CSV).write_bytes((f / CSV).read_text().encode("utf-16")))),
        (CSV, "byte 1", "UTF-8"),
    ),
    Case(
        "semicolons",
        every_line(lambda t: t.replace(",", ";")),
        (CSV, "row 1", "semicolons", "comma delimited"),
    ),
    Case(
        "European spreadsheet",
        every_line(lambda t: t.replace(",", ";").replace(".", ",")),
        (CSV, "row", "semicolons", "decimal point"),
    ),
    Case(
        "tabs",
        every_line(lambda t: t.replace(",", "\t")),
        (CSV, "row 1", "tabs", "comma delimited"),
    ),
    Case(
        "unclosed quote", sub(CSV, r"^1,", '"1,'), (CSV, "row 2", "breaks off", "export it again")
    ),
    Case("NUL byte", sub(CSV, r"^1,", "\0001,"), (CSV, "row 2", "column sample", "correct it")),
    Case(
        "duplicate column",
        column("q2_deg", str, "q1_deg"),
        (CSV, "row 1", "column q1_deg", "rename"),
    ),
    Case(
        "column without a name",
        column("time_s", str, " "),
        (CSV, "row 1", "column name", "name the column"),
    ),
    Case("row too long", sub(CSV, r"^2,", "2,7,"), (CSV, "row 3", "cells", "decimal point")),
    Case("row too short", sub(CSV, r"^2,", ""), (CSV, "row 3", "cells", "fill")),
    Case(
        "word for a number", cell(4, "q3_deg", "abc"), (CSV, "row 4", "q3_deg", "'abc'", "correct")
    ),
    Case(
        "quote in the middle",
        sub(CSV, r"^2,([-\d]+)\.", r'2,"\1,"'),
        (CSV, "row 3", "breaks off", "quotes"),
    ),
    Case(
        "quoted decimal comma",
        sub(CSV, r"^2,([-\d]+)\.(\d+)", r'2,"\1,\2"'),
        (CSV, "row 3", "q1_deg", "decimal comma", "write a point"),
    ),
    Case("empty cell", cell(5, "x_mm", ""), (CSV, "row 5", "x_mm", "empty cell", "fill it")),
    Case("NaN", cell(5, "x_mm", "nan"), (CSV, "row 5", "(sample 4)", "x_mm", "nan", "correct")),
    Case(
        "infinity",
        cell(6, "temperature_c", "-inf"),
        (CSV, "row 6", "temperature_c", "inf", "correct"),
    ),
    Case("absurd number", cell(6, "y_mm", "1e40"), (CSV, "row 6", "y_mm", "finite", "correct")),
    Case("unknown text column", add("operator", "Ann"), (CSV, "row 2", "operator", "note")),
    # samples.csv, what the kind needs
    Case("no sample column", drop("sample"), (CSV, "column sample", "add it")),
    Case("no ball column", drop("ball"), (CSV, "column ball", "add it")),
    Case("no z", drop("z_mm"), (CSV, "column z_mm", "add it")),
    Case(
        "points named in metres",
        column("([xyz])_mm", thousandth, r"\1_m"),
        (CSV, "column x_mm", "x_m", "rename"),
    ),
    Case("no point column", drop("point"), (CSV, "column point", "add it"), "touch-point"),
    Case("no sphere column", drop("sphere"), (CSV, "column sphere", "add it"), "laser-spot"),
    Case("no length", drop("length_mm"), (CSV, "column length_mm", "add it"), "distance"),
    Case("no plane", drop("plane"), (CSV, "column plane", "add it"), "plane-touch"),
    Case("no quaternion", drop("qw"), (CSV, "column qw", "add it"), "external-pose"),
    Case("half an axis", drop("nz"), (CSV, "nx ny nz", "neither", "add"), "partial-pose"),
    Case(
        "no joints",
        both(*(drop(f"q{k}_deg") for k in range(1, 7))),
        (CSV, "q1_deg", "none", "add them"),
    ),
    Case(
        "joints named in radians",
        column("(q.)_deg", radians, r"\1_rad"),
        (CSV, "q1_rad", "rename it to q1_deg"),
    ),
    Case("gap in the joints", drop("q4_deg"), (CSV, "q4_deg", "add the missing joint")),
    Case(
        "too few joints",
        drop("q6_deg"),
        (CSV, "q5_deg", "6 joints", "5 joint columns", "robot file"),
    ),
    Case(
        "too many joints",
        add("q7_deg", "0"),
        (CSV, "q7_deg", "6 joints", "7 joint columns", "robot file"),
    ),
    Case("millimetres for degrees", column("q6_deg", str, "q6_mm"), (CSV, "q6_mm", "deg", "kind")),
    # samples.csv, values
    Case(
        "sample not whole", cell(3, "sample", "2.5"), (CSV, "row 3", "sample", "2.5", "number them")
    ),
    Case(
        "duplicate sample",
        cell(7, "sample", "2"),
        (CSV, "row 7", "sample", "first in row 3", "another number"),
    ),
    Case("ball not whole", cell(3, "ball", "1.5"), (CSV, "row 3", "ball", "1.5", "number them")),
    Case(
        "reflector not whole",
        add("reflector", "1.2"),
        (CSV, "row 2", "reflector", "1.2", "number them"),
    ),
    Case("pose not whole", cell(3, "pose", "0.1"), (CSV, "row 3", "pose", "0.1", "number them")),
    Case(
        "unknown ball", cell(3, "ball", "9"), (CSV, "row 3", "ball", "(1, 2, 3, 4)", "add the ball")
    ),
    Case(
        "approach is a speed",
        cell(3, "approach1", "0.5"),
        (CSV, "row 3", "approach1", "-1, 0 or 1", "sign"),
    ),
    Case(
        "fixed to the ceiling",
        add("fixed_to", "ceiling"),
        (CSV, "row 2", "fixed_to", "'ceiling'", "write one"),
    ),
    Case("nothing on the tool", add("fixed_to", "base"), (CSV, "fixed_to", "none", "add the rows")),
    Case(
        "row sigma zero",
        add("sigma_mm", "0"),
        (CSV, "row 2", "sigma_mm", "above 0", "delete the column"),
    ),
    Case(
        "length zero",
        cell(4, "length_mm", "0"),
        (CSV, "row 4", "length_mm", "above 0", "correct"),
        "distance",
    ),
    Case(
        "pair of one", cell(4, "pair", "77"), (CSV, "pair", "two rows", "same number"), "distance"
    ),
    Case(
        "points touched once",
        numbered("point"),
        (CSV, "row 2", "point", "same number"),
        "touch-point",
    ),
    Case(
        "quaternion not unit",
        cell(4, "qw", "0.9"),
        (CSV, "row 4", "qw qx qy qz", "length 1", "divide"),
        "external-pose",
    ),
    Case(
        "axis not unit",
        cell(4, "nx", "0.9"),
        (CSV, "row 4", "nx ny nz", "length 1", "divide"),
        "partial-pose",
    ),
    # samples.csv, what cannot be
    Case("radians for degrees", column(Q, radians), (CSV, "q1_deg", "radians", "57.29578")),
    Case(
        "radians, touched points",
        column(Q, radians),
        (CSV, "q1_deg", "radians", "57.29578"),
        "touch-point",
    ),
    Case(
        "radians, outside",
        column(Q, radians),
        (CSV, "q1_deg", "radians", "57.29578"),
        "external-point",
    ),
    Case(
        "metres, outside",
        column("[xyz]_mm", thousandth),
        (CSV, "x_mm, y_mm, z_mm", "metres", "1000"),
        "external-point",
    ),
    Case(
        "metres, a ball",
        column("[xyz]_mm", thousandth),
        (CSV, "x_mm, y_mm, z_mm", "metres", "1000"),
    ),
    Case(
        "micrometres",
        column("[xyz]_mm", lambda v: str(1000 * float(v))),
        (CSV, "points that move", "convert"),
        "external-point",
    ),
    Case(
        "two balls swapped",
        cell(5, "ball", "3"),
        (CSV, "row 5", "ball", "balls 1 and 2", "swapped"),
    ),
    Case(
        "ball moved between",
        cell(5, "x_mm", "7"),
        (CSV, "row 5", "ball", "rows 4 and 5", "correct"),
    ),
    # artefact.csv
    Case("no artefact.csv", remove(ART), (ART, "no such file", "put it there")),
    Case("artefact without radius", drop("radius_mm", ART), (ART, "column radius_mm", "add it")),
    Case(
        "ball twice", cell(3, "ball", "1", ART), (ART, "row 3", "ball", "once", "number the balls")
    ),
    Case("radius zero", cell(3, "radius_mm", "0", ART), (ART, "row 3", "radius_mm", "correct it")),
    Case(
        "artefact in metres",
        column("[xyz]_mm|radius_mm", thousandth, file=ART),
        (ART, "row 2", "radius_mm", "metres"),
    ),
    Case("artefact not finite", cell(4, "y_mm", "nan", ART), (ART, "row 4", "y_mm", "correct")),
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
    # Parquet
    Case(
        "not Parquet",
        both(write("samples.parquet", b"PAR1 no"), sub(TOML, "samples.csv", "samples.parquet")),
        ("samples.parquet", "cannot be read", "write it again"),
    ),
    Case(
        "Parquet list",
        parquet(sample=[1], q1_deg=[[1.0, 2.0]]),
        ("samples.parquet", "column q1_deg", "list", "convert"),
    ),
    Case(
        "Parquet null",
        parquet(sample=[1, 2], q1_deg=[1.0, None]),
        ("samples.parquet", "row 2", "q1_deg", "fill it"),
    ),
    Case(
        "Parquet text",
        parquet(sample=["1"], q1_deg=[1.0]),
        ("samples.parquet", "column sample", "string", "convert"),
    ),
]


def test_table_is_long_and_names_are_unique():
    assert len(CASES) >= 45
    assert len({case.name for case in CASES}) == len(CASES)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_broken_recording_gets_its_sentence(tmp_path, case):
    folder = write_good(tmp_path / "cell-4", case.measures)
    datasets.read(folder)
    case.patch(folder)
    with pytest.raises(InputError) as caught:
        datasets.read(folder)
    sentence = str(caught.value)
    assert (
        "\n" not in sentence
        and sentence.endswith(".")
        and ": expected " in sentence
        and ", found " in sentence
    )
    for word in case.words:
        assert word in sentence, sentence
    assert str(tmp_path) not in sentence


def test_folder_that_is_not_there_names_what_is_known():
    with pytest.raises(InputError, match="irb120_faro"):
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
