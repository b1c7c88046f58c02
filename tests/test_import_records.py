"""Readers of text with several lines for each sample and of nested records, from own numbers."""

import json

import numpy as np
import pytest
from scipy.io import savemat

from datasets.importers.mapping.joined_tables.joining import join_tables
from datasets.importers.mapping.model import Join
from datasets.importers.source import RawTable
from datasets.importers.sources.choice import read_sources

NUMBERS = np.round(np.random.default_rng(4).normal(size=(6, 7)), 4)


def poses(seed):
    rng = np.random.default_rng(seed)
    made = np.tile(np.eye(4), (6, 1, 1))
    made[:, :3, 3] = np.round(rng.normal(size=(6, 3)), 4)
    return made


def read(path):
    (table,) = read_sources([path], path.parent).tables
    return table


def written(path, text):
    path.write_text(text)
    return read(path)


def test_blocks_of_labelled_lines_are_rows(tmp_path):
    lines = [
        f"CURRENT POSITION (GROUP 1)\nJoint 1: {q[0]:10.4f} deg\nJoint 2: {q[1]:10.4f} deg\n"
        f"- Translation: [{q[2]:.4f}, {q[3]:.4f}, {q[4]:.4f}]\n\n"
        for q in NUMBERS
    ]
    table = written(tmp_path / "dump.txt", "".join(lines))
    names = ["Joint 1", "Joint 2", "Translation 1", "Translation 2", "Translation 3"]
    assert list(table.columns) == names
    assert np.allclose(np.stack(list(table.columns.values()), 1), NUMBERS[:, :5])
    assert table.units == {"Joint 1": "deg", "Joint 2": "deg"}


def test_rows_of_two_objects_by_turns_are_two_sets_of_columns(tmp_path):
    rows = [
        f"{name},{','.join(map(str, sign * row))}\n"
        for row in NUMBERS
        for name, sign in (("hand", 1), ("eye", -1))
    ]
    table = written(tmp_path / "pairs.txt", "".join(rows))
    assert list(table.columns) == [f"{n} {k}" for n in ("hand", "eye") for k in range(1, 8)]
    assert np.allclose(table.columns["eye 3"], -NUMBERS[:, 2])


def test_a_table_with_a_known_header_keeps_its_rows(tmp_path):
    rows = [f"{name},{','.join(map(str, row[:3]))}\n" for row in NUMBERS for name in "AB"]
    table = written(tmp_path / "points.csv", "Name,X,Y,Z\n" + "".join(rows))
    assert list(table.columns) == ["Name", "X", "Y", "Z"]
    assert table.n == 12


def test_an_incomplete_last_block_is_left_out_with_a_warning(tmp_path):
    text = "".join(f"Joint 1: {a}\nJoint 2: {b}\n" for a, b in NUMBERS[:, :2]) + "Joint 1: 0.5\n"
    table = written(tmp_path / "dump.txt", text)
    assert table.n == 6
    assert "no complete block" in table.warnings[0]


def stamped(number, content):
    stamp = f"header:\n  seq: {number}\n  stamp:\n    secs: {1700000000 + number}\n    nsecs: 500000000\n"
    return f"{stamp}{content}---\n"


def test_yaml_documents_of_joint_states_have_the_names_of_the_joints(tmp_path):
    text = "".join(
        stamped(k, f"name: [elbow, pan]\nposition: [{row[0]}, {row[1]}]\nvelocity: []\n")
        for k, row in enumerate(NUMBERS)
    )
    table = written(tmp_path / "states.yaml", text)
    assert np.allclose(table.columns["elbow [rad]"], NUMBERS[:, 0])
    assert np.allclose(table.columns["pan [rad]"], NUMBERS[:, 1])
    assert np.allclose(np.diff(table.columns["header stamp [s]"]), 1)


def test_joint_values_below_their_names(tmp_path):
    content = {"joint_names": ["pan", "elbow"], "joint_values": NUMBERS[:, :2].tolist()}
    table = written(tmp_path / "states.json", json.dumps(content))
    assert np.allclose(table.columns["elbow"], NUMBERS[:, 1])


def transform(row):
    vector = dict(zip("xyz", map(float, row[:3])))
    return {"translation": vector, "rotation": dict(zip("xyzw", map(float, row[3:])))}


@pytest.mark.parametrize(
    "content",
    [
        {"samples": [{"optical": transform(-row), "robot": transform(row)} for row in NUMBERS]},
        {
            "optical": {"transforms": [transform(-row) for row in NUMBERS]},
            "robot": {"transforms": [transform(row) for row in NUMBERS]},
        },
    ],
)
def test_lists_of_records_below_other_keys(tmp_path, content):
    table = written(tmp_path / "samples.json", json.dumps(content))
    (x,) = [name for name in table.columns if name.endswith("translation x") and "robot" in name]
    assert np.allclose(table.columns[x], NUMBERS[:, 0])
    assert len(table.columns) == 14


def test_pairs_of_matrices_of_scripts(tmp_path):
    pair = np.stack([poses(1), poses(2)], axis=1)
    (tmp_path / "pairs.json").write_text(json.dumps(pair.tolist()))
    np.save(tmp_path / "stacked.npy", pair.swapaxes(0, 1))
    cells = np.empty((6, 2), object)
    for k in range(6):
        cells[k, 0], cells[k, 1] = pair[k]
    savemat(tmp_path / "cells.mat", {"A": cells[:, :1], "B": cells[:, 1:]})
    expected = {"pairs.json": "pairs 2 x", "stacked.npy": "stacked 2 x", "cells.mat": "B x"}
    for file, name in expected.items():
        table = read(tmp_path / file)
        assert len(table.columns) == 24
        assert np.allclose(table.columns[name], poses(2)[:, 0, 3])


def test_message_numbers_of_a_log_and_of_an_instrument_join_no_rows():
    def table(file, rate, count):
        rows = np.arange(count)
        cells = {"seq": rows.astype(float), "time [s]": rows / rate, "value": rows / rate}
        return RawTable(file, cells, rows + 1)

    joined, join, _ = join_tables([table("log", 50.0, 500), table("track", 2.0, 20)], Join())
    assert join.by == "time"
    assert np.array_equal(joined.columns["track: time [s]"], np.arange(20) / 2)
