"""Rows as columns: the mappings that they stand for, parts of them, and answers that are written an element at a time."""

import json

import numpy as np
import pytest

from datasets.recording_files.rows import Rows
from workbench.commands.shared import answer
from workbench.files.spool import Made, Spool

TABLE = {
    "image": np.array(["b.png", "a.png", "c.png", "d.png"]),
    "role": np.array(["scan", "board", "scan", "scan"]),
    "scan": np.array(["2", "", "1", "2"]),
    "step": np.array([1.0, np.nan, 0.0, 0.0]),
    "time_s": np.array([0.5, 1.0, 2.0, np.nan]),
}
ROWS = [
    {"image": "b.png", "role": "scan", "scan": "2", "step": 1, "time_s": 0.5},
    {"image": "a.png", "role": "board", "scan": "", "time_s": 1.0},
    {"image": "c.png", "role": "scan", "scan": "1", "step": 0, "time_s": 2.0},
    {"image": "d.png", "role": "scan", "scan": "2", "step": 0},
]


def test_rows_are_the_mappings_that_their_columns_hold():
    made = Rows.of(TABLE, ["step"])
    assert len(made) == 4 and list(made) == ROWS and made[-1] == ROWS[-1]
    assert (
        made == tuple(ROWS) and tuple(ROWS) == made and made != ROWS[:3] and made[1:3] == ROWS[1:3]
    )
    assert type(made[0]["step"]) is int and type(made[0]["time_s"]) is float
    assert Rows.of({}) == () and not Rows.of({})


def test_rows_are_chosen_and_grouped_in_their_order():
    made = Rows.of(TABLE, ["step"]).where("role", "scan")
    assert made == [ROWS[0], *ROWS[2:]]
    assert {name: list(mine) for name, mine in made.by("scan").items()} == {
        "2": [ROWS[0], ROWS[3]],
        "1": [ROWS[2]],
    }
    assert (
        list(made.by("scan")) == ["2", "1"]
        and len(made.by("scan")) == 2
        and made.by("scan")["1"] == [ROWS[2]]
    )
    assert (
        list(made.by("scan", "step")["2"]) == [ROWS[3], ROWS[0]]
        and "" not in made.by("scan")
        and "3" not in made.by("scan")
    )
    assert not made[:0].by("scan")
    assert made.values("step", -1).tolist() == [1, 0, 0] and made.values("time_s", -1).tolist() == [
        0.5,
        2,
        -1,
    ]
    assert made.values("none", 7).tolist() == [7, 7, 7] and not made.where("none", "x")


def test_mappings_of_any_kind_become_rows():
    made = Rows.kept(
        [{k: v for k, v in row.items() if v != ""} for row in ROWS], ("image", "role", "scan")
    )
    assert made == ROWS and Rows.kept(made, ()) is made
    assert (
        Rows.kept([{"role": "scan", "scan": 3}], ("role", "scan")).where("role", "scan")[0]["scan"]
        == "3"
    )


@pytest.mark.parametrize(
    "content",
    [{}, {"none": []}, {"a": {"b": [1, {"c": float("inf")}]}, "é": ("x\n", 2), "n": np.arange(3)}],
)
def test_an_answer_in_parts_is_the_answer(content):
    plain = json.loads(answer.as_text(content))
    assert answer.as_text(content) == json.dumps(plain, indent=2, ensure_ascii=False) + "\n"


def test_what_is_made_of_a_long_sequence_is_made_when_it_is_asked_for():
    asked = []
    made = Made(Spool(range(200), in_memory=3), lambda k: asked.append(k) or {"k": k})
    assert len(made) == 200 and not asked
    assert (
        made[150] == {"k": 150}
        and made[-2:] == [{"k": 198}, {"k": 199}]
        and asked == [150, 198, 199]
    )
    content = {"scans": made, "within": {"scans": made}}
    assert json.loads(answer.as_text(content)) == {
        "scans": [{"k": k} for k in range(200)],
        "within": {"scans": [{"k": k} for k in range(200)]},
    }
    assert sum(1 for _ in answer.text_chunks(content)) > 200
