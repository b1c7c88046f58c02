"""Changes that break a good recording, and the check of the sentence that each must get."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

import datasets
from datasets.errors import InputError
from datasets.samples.columns import FLANGE
from good_recordings import write_good

TOML, ROBOT, CSV, ART, IMG = (
    "recording.toml",
    "robot.toml",
    "samples.csv",
    "artefact.csv",
    "images.csv",
)
Q = r"q\d_deg"


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


def effect_indices(name: str) -> Callable[[Path], None]:
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


def with_flange(folder, measures="ball-surface"):
    """A folder whose arm gave flange poses and no joints: no robot file is needed."""
    write_good(folder, measures)
    for number in range(1, 7):
        drop(f"q{number}_deg")(folder)
    for name, value in zip(FLANGE, ("500.5", "-20", "310", "0.5", "0.5", "-0.5", "0.5")):
        add(name, value)(folder)
    sub(TOML, r"\[robot\]\nfile.*\n", "")(folder)
    (folder / "robot.toml").unlink()
    return folder


def assert_sentence(folder: Path, case: Case) -> None:
    """The good recording in `folder` reads; broken, it gets one sentence with all words of the case and no path."""
    datasets.read(folder)
    case.patch(folder)
    with pytest.raises(InputError) as caught:
        datasets.read(folder)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert sentence.endswith(".")
    assert ": expected " in sentence
    assert ", found " in sentence
    for word in case.words:
        assert word in sentence, sentence
    assert str(folder.parent) not in sentence
