"""Recordings with images and with flange poses: read, written next to their images, and every mistake in them named."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import datasets
from broken_recordings import (
    IMG,
    TOML,
    Case,
    assert_sentence,
    both,
    cell,
    drop,
    sub,
    with_flange,
    write,
)
from datasets import registry
from datasets.errors import InputError
from datasets.recording import Recording
from good_recordings import real_set, write_good

HEADER = "image,role,placement,scan,step,mirror_deg,sample,sweep,mirror_speed_deg_s,time_s,temperature_c,note"


ROWS = (
    "images/a.png,board,1,,,,1,,,0.5,21.0,by hand",
    "images/b.png,board-laser,1,,0,1.5,,-1,3.0,1.0,21.0,",
    "images/d.png,board-laser,1,,0,1.5,,1,3.0,1.5,21.0,",
    "images/c.png,scan,,1,1,2.5,2,1,3.0,2.0,21.5,",
)


def write_images(folder, measures="scan-images"):
    """A folder with every column of images.csv, some cells of them empty."""
    write_good(folder, measures)
    cv2.imwrite(str(folder / "images" / "d.png"), np.full((12, 16), 7, np.uint8))
    (folder / IMG).write_text("\n".join((HEADER, *ROWS)) + "\n", encoding="utf-8")
    return folder


def test_every_column_of_images_is_read(tmp_path):
    rows = datasets.read(write_images(tmp_path / "good")).images
    assert rows[0] == {
        "image": "images/a.png",
        "role": "board",
        "placement": "1",
        "scan": "",
        "sample": 1,
        "time_s": 0.5,
        "temperature_c": 21.0,
        "note": "by hand",
    }
    assert (
        rows[1]["step"] == 0
        and isinstance(rows[1]["step"], int)
        and rows[1]["mirror_deg"] == 1.5
        and rows[1]["sweep"] == -1
    )
    assert (
        rows[3]["sample"] == 2
        and rows[3]["scan"] == "1"
        and rows[3]["mirror_speed_deg_s"] == 3.0
        and "sample" not in rows[2]
    )


def test_scans_of_an_arm_need_no_points(tmp_path):
    """Joints, balls and images; what the samples will be is found in the images."""
    folder = write_images(tmp_path / "good")
    sub(TOML, r"\[images\]", '[artefact]\nfile = "artefact.csv"\n[images]')(folder)
    (folder / "artefact.csv").write_text("ball,x_mm,y_mm,z_mm,radius_mm\n1,0,0,0,15\n")
    found = datasets.read(folder)
    assert (
        found.joints.shape == (12, 6)
        and found.balls == {1: (0.0, 0.0, 0.0, 15.0)}
        and "x_mm" not in found.columns
    )
    with pytest.raises(InputError, match="measured points, found none in a scan-images recording"):
        found.points


@pytest.mark.parametrize("made", [write_images, with_flange])
def test_written_and_read_again_is_the_same(tmp_path, made):
    first = datasets.read(made(tmp_path / "good"))
    second = datasets.read(datasets.write(first, tmp_path / "copy"))
    assert second.images == first.images and second.board == first.board
    for name, values in first.columns.items():
        np.testing.assert_array_equal(second.columns[name], values)


BOARDS = [
    {
        "kind": "charuco",
        "columns": 7,
        "rows": 5,
        "square_mm": 10.0,
        "marker_mm": 7.5,
        "dictionary": "DICT_5X5_250",
        "legacy": True,
    },
    {
        "kind": "circles",
        "columns": 4,
        "rows": 11,
        "square_mm": 20.0,
        "asymmetric": True,
        "fixed_to": "tool",
    },
]


def in_place(folder, board=BOARDS[0]):
    """What a renderer has: images in their folder, and the rows that name them."""
    (folder / "images").mkdir(parents=True)
    rows = []
    for k in range(3):
        cv2.imwrite(str(folder / "images" / f"{k}.png"), np.full((12, 16), k, np.uint8))
        rows.append(
            {"image": f"images/{k}.png", "role": "board", "placement": str(k)}
            | ({"time_s": 2.5} if k else {})
        )
    return Recording(
        "board-images",
        {},
        {},
        title="made",
        images=tuple(rows),
        board=board,
        name="made",
        folder=folder,
    )


@pytest.mark.parametrize("board", BOARDS, ids=lambda b: b["kind"])
def test_written_next_to_existing_images(tmp_path, board):
    made = in_place(tmp_path / "made", board)
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "made" / "images").iterdir()}
    assert datasets.write(made, tmp_path / "made") == tmp_path / "made"
    found = datasets.read(tmp_path / "made")
    assert found.images == tuple(
        {
            "image": r["image"],
            "role": "board",
            "placement": r["placement"],
            **({"time_s": 2.5} if "time_s" in r else {}),
        }
        for r in made.images
    )
    assert found.board == board
    assert before == {p: p.stat().st_mtime_ns for p in (tmp_path / "made" / "images").iterdir()}
    with pytest.raises(InputError, match="new or empty folder"):
        datasets.write(made, tmp_path / "made")


def test_writing_next_to_images_changes_no_other_file(tmp_path):
    made = in_place(tmp_path / "made")
    (tmp_path / "made" / IMG).write_text("mine")
    with pytest.raises(InputError, match="made/images.csv: expected a folder with images only"):
        datasets.write(made, tmp_path / "made")
    assert (tmp_path / "made" / IMG).read_text() == "mine"
    (tmp_path / "made" / IMG).unlink()
    (tmp_path / "made" / "images" / "1.png").unlink()
    with pytest.raises(InputError, match="made/images/1.png: expected an image that lies there"):
        datasets.write(made, tmp_path / "made")
    assert [p.name for p in (tmp_path / "made").iterdir()] == ["images"]
    with pytest.raises(InputError, match="new or empty folder"):
        datasets.write(replace(made, folder=tmp_path), tmp_path / "made")


def image(row, column, value):
    return cell(row, column, value, IMG)


def board(line):
    """One more key under [board], which stands last."""
    return lambda folder: bool(
        (folder / TOML).write_text((folder / TOML).read_text() + line + "\n")
    )


def charuco(*lines):
    return both(sub(TOML, "chessboard", "charuco"), *(board(line) for line in lines))


def half_a_bmp(folder):
    ok, content = cv2.imencode(".bmp", np.zeros((12, 16), np.uint8))
    (folder / "images" / "a.png").write_bytes(content.tobytes()[:1] + b"x")


CASES = [
    Case(
        "image listed twice",
        image(3, "image", "images/a.png"),
        (IMG, "row 3", "column image", "again (first in row 2)", "delete the copy"),
    ),
    Case(
        "image listed twice by another path",
        image(3, "image", "images/./a.png"),
        (IMG, "row 3", "every image once", "row 2"),
    ),
    Case(
        "image elsewhere",
        image(2, "image", "../../a.png"),
        (IMG, "row 2", "leaves it", "copy the file"),
    ),
    Case(
        "image at an absolute path",
        image(2, "image", "/data/a.png"),
        (IMG, "row 2", "absolute path", "copy the file"),
    ),
    Case(
        "image without a name",
        image(2, "image", ""),
        (IMG, "row 2", "a file name", "name a file"),
    ),
    Case(
        "image is a folder",
        image(2, "image", "images"),
        (IMG, "row 2", "a folder", "correct the name"),
    ),
    Case(
        "image of another kind",
        half_a_bmp,
        (IMG, "row 2", "another kind of file", "save it as PNG"),
    ),
    Case(
        "image truncated",
        lambda f: write("images/d.png", (f / "images/d.png").read_bytes()[:-12])(f),
        (IMG, "row 4", "no end", "copy it again"),
    ),
    Case(
        "image empty", write("images/d.png", b""), (IMG, "row 4", "images/d.png", "an empty file")
    ),
    Case("no image column", drop("image", IMG), (IMG, "column image", "no such column", "add it")),
    Case("no role column", drop("role", IMG), (IMG, "column role", "no such column", "add it")),
    Case(
        "role misspelt",
        image(3, "role", "board_laser"),
        (IMG, "row 3", "column role", "'board_laser'", "board-laser"),
    ),
    Case(
        "role empty",
        image(3, "role", ""),
        (IMG, "row 3", "column role", "''", "write one of these"),
    ),
    Case(
        "laser row without placement",
        image(3, "placement", ""),
        (IMG, "row 3", "which placement", "add a placement"),
    ),
    Case("scan without a number", image(5, "scan", ""), (IMG, "row 5", "which scan", "add a scan")),
    Case(
        "laser where no board was seen",
        image(3, "placement", "9"),
        (IMG, "row 3", "an image of role board", "none at '9'", "add that image"),
    ),
    Case(
        "step twice",
        image(4, "sweep", "-1"),
        (IMG, "row 4", "column step", "every step of a placement once", "row 3"),
    ),
    Case(
        "step not whole",
        image(3, "step", "0.5"),
        (IMG, "row 3", "column step", "0.5", "number them"),
    ),
    Case(
        "step is a word",
        image(3, "step", "first"),
        (IMG, "row 3", "column step", "'first'", "correct it"),
    ),
    Case("sample not whole", image(2, "sample", "1.5"), (IMG, "row 2", "column sample", "1.5")),
    Case(
        "sample unknown",
        image(2, "sample", "99"),
        (IMG, "row 2", "a sample of samples.csv", "99", "correct the number"),
    ),
    Case(
        "sweep is a speed",
        image(3, "sweep", "3"),
        (IMG, "row 3", "column sweep", "-1, 0 or 1", "direction"),
    ),
    Case(
        "mirror angle not finite",
        image(3, "mirror_deg", "nan"),
        (IMG, "row 3", "mirror_deg", "nan", "correct the cell"),
    ),
    Case(
        "time infinite",
        image(3, "time_s", "inf"),
        (IMG, "row 3", "time_s", "finite", "correct the cell"),
    ),
    Case(
        "temperature with a comma",
        image(3, "temperature_c", '"21;5"'),
        (IMG, "row 3", "temperature_c", "a number"),
    ),
    Case(
        "mirror angle without a unit",
        sub(IMG, "mirror_deg", "mirror"),
        (IMG, "column mirror", "mirror_deg", "rename"),
    ),
    Case(
        "mirror angle in radians",
        sub(IMG, "mirror_deg", "mirror_rad"),
        (IMG, "column mirror_rad", "mirror_deg", "convert it"),
    ),
    Case("no image at all", write(IMG, (HEADER + "\n").encode()), (IMG, "at least one row")),
    Case(
        "sample without samples",
        sub(TOML, r"\[samples\]\nfile.*\n", ""),
        (IMG, "row 2", "a sample of samples.csv", "add [samples]"),
    ),
    # [board]
    Case(
        "unknown dictionary",
        charuco('dictionary = "DICT_9X9"', "marker_mm = 3.0"),
        (TOML, "dictionary", "DICT_5X5_250", "'DICT_9X9'"),
    ),
    Case(
        "ChArUco without markers",
        charuco('dictionary = "DICT_5X5_250"'),
        (TOML, "key marker_mm", "none", "add it"),
    ),
    Case(
        "ChArUco without dictionary",
        charuco("marker_mm = 3.0"),
        (TOML, "key dictionary", "none", "add it"),
    ),
    Case(
        "marker as large as its square",
        charuco("marker_mm = 5.0", 'dictionary = "DICT_5X5_250"'),
        (TOML, "marker_mm", "smaller than its square of 5 mm", "measure both"),
    ),
    Case(
        "asymmetric chessboard",
        board("asymmetric = true"),
        (TOML, "key asymmetric", "circles only", "remove it"),
    ),
    Case(
        "asymmetric is a word",
        board('asymmetric = "yes"'),
        (TOML, "key asymmetric", "true or false", "correct"),
    ),
    Case(
        "board on the ceiling",
        board('fixed_to = "ceiling"'),
        (TOML, "key fixed_to", "tool, base, floor", "correct"),
    ),
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_mistake_in_images_gets_its_sentence(tmp_path, case):
    assert_sentence(write_images(tmp_path / "cell-4"), case)


@pytest.mark.parametrize(
    ("name", "roles"),
    [
        ("opencv_stereo_chess:left", {"board": 13}),
        ("opencv_stereo_chess:right", {"board": 13}),
        ("linelaser_circlegrid_zhao", {"board": 12, "board-laser": 12}),
        ("handeye_open3dv:in-hand", {"board": 8}),
        ("handeye_open3dv:to-hand", {"board": 5}),
    ],
)
def test_real_images_are_named_where_they_lie(real, name, roles):
    """By reference: every row names an image in the set's own folder, and no placement is without its board."""
    found = real_set(real, name)
    assert {
        role: sum(r["role"] == role for r in found.images)
        for role in {r["role"] for r in found.images}
    } == roles
    assert all(
        (found.folder / row["image"]).is_file() for row in found.images
    ) and found.folder == registry.find(name)
    assert found.licence and found.source.startswith("https://") and len(found.sha256) == 64
    assert {r["placement"] for r in found.images} == {
        r["placement"] for r in found.images if r["role"] == "board"
    }


@pytest.mark.parametrize(
    ("name", "profiles", "radius"),
    [("spherescan_handeye_pan:r40", 15, 40.0), ("spherescan_handeye_pan:r12", 10, 12.7)],
)
def test_real_profiles_are_arcs_of_the_ball(real, name, profiles, radius):
    """Every profile is plane, and its best circle is no larger than the ball."""
    found = real_set(real, name)
    assert (
        len(set(found.poses)) == profiles
        and not found.points[:, 1].any()
        and found.balls[1][3] == radius
    )
    radii = []
    for pose in range(profiles):
        x, _, z = found.points[found.poses == pose].T
        a = np.column_stack([2 * x, 2 * z, np.ones(len(x))])
        u, v, w = np.linalg.lstsq(a, x**2 + z**2, rcond=None)[0]
        radii.append(np.sqrt(w + u * u + v * v))
    assert np.median(radii) < radius * 1.05 and len(found.flange) == found.n


def test_set_that_cannot_be_fetched_says_how_it_is_made(tmp_path):
    with pytest.raises(
        InputError,
        match=r"opencv_stereo_chess/.*packages.debian.org.*unpack the Debian package opencv-doc",
    ):
        datasets.get("opencv_stereo_chess", tmp_path)
