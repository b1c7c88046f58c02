"""Small recordings of every kind read without complaint."""

import pytest

import datasets
from datasets.samples.columns import KINDS
from good_recordings import POSES, write_good


@pytest.mark.parametrize("measures", KINDS)
def test_every_kind_reads(tmp_path, measures):
    recording = datasets.read(write_good(tmp_path / "good", measures))
    assert recording.measures == measures
    assert recording.n == 2 * POSES
    assert recording.joints.shape == (2 * POSES, 6)
    assert len(set(recording.poses)) == POSES


def test_spreadsheet_habits_are_read(tmp_path):
    """A byte order mark, Windows line ends, blank last lines and an empty fixed_to are no error."""
    folder = write_good(tmp_path / "good")
    lines = (folder / "samples.csv").read_text().splitlines()
    text = "\r\n".join(
        [
            lines[0] + ",fixed_to,note",
            lines[1] + ",base,hit the table",
            *(f"{line},," for line in lines[2:]),
            "",
            ",,",
        ]
    )
    (folder / "samples.csv").write_bytes(b"\xef\xbb\xbf" + text.encode())
    recording = datasets.read(folder)
    assert recording.n == 2 * POSES
    assert list(recording.moving) == [False] + [True] * (2 * POSES - 1)
    assert recording.columns["note"][0] == "hit the table"


def test_keys_that_nobody_knows_are_left_alone(tmp_path):
    """Further keys and sections are no error unless they look like a known key in other clothes."""
    folder = write_good(tmp_path / "good")
    text = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(
        'license = "CC0"\noperator = "Ann"\n'
        + text
        + "[clouds]\nfolder = 'clouds'\n[board_note]\na = 1\n"
    )
    assert datasets.read(folder).n == 2 * POSES


def test_small_range_is_believed_when_said(tmp_path):
    folder = write_good(tmp_path / "good", "touch-point")
    lines = (folder / "samples.csv").read_text().splitlines()
    cells = [line.split(",") for line in lines[1:]]
    rows = [",".join([c[0], *(str(float(v) / 60) for v in c[1:7]), *c[7:]]) for c in cells]
    (folder / "samples.csv").write_text("\n".join([lines[0], *rows]))
    with pytest.raises(datasets.InputError, match="small_range"):
        datasets.read(folder)
    toml = (
        (folder / "recording.toml")
        .read_text()
        .replace('file = "samples.csv"', 'file = "samples.csv"\nsmall_range = true')
    )
    (folder / "recording.toml").write_text(toml)
    assert datasets.read(folder).n == 2 * POSES


def test_short_move_near_zero_of_one_joint_is_no_radian(tmp_path):
    """A recording that stays at the arm's zero pose, or moves one joint a little, is taken as it is."""
    folder = write_good(tmp_path / "good", "touch-point")
    lines = (folder / "samples.csv").read_text().splitlines()
    rows = [
        ",".join([c[0], str(0.5 * k), "0", "0", "0", "0", "0", *c[7:]])
        for k, c in enumerate(x.split(",") for x in lines[1:])
    ]
    (folder / "samples.csv").write_text("\n".join([lines[0], *rows]))
    assert datasets.read(folder).n == 2 * POSES
