"""Loads of targets: extrapolated a little, refused far outside of the recorded ones, uncertain where none is recorded."""

import pytest

from test_correction_limits import JOINTS, RANGE, answer_of, elastic, solution


@pytest.mark.parametrize(
    ("payload", "status", "words"),
    [
        (2.0, 0, ""),
        (3.2, 0, ""),
        (5.0, 0, "the load on the flange is outside 0.5 to 3 kg"),
        (7.0, 1, "the load on the flange of 7 kg is far outside 0.5 to 3 kg"),
        (5000.0, 1, "far outside 0.5 to 3 kg"),
    ],
)
def test_a_load_is_extrapolated_a_little_and_no_more(workbench, tmp_path, payload, status, words):
    """5000 kg once gave a correction of 205 mm and status 0."""
    elastic(tmp_path / "arm")
    text = f"{JOINTS},payload_kg\n0,10,10,0,30,0,{payload}\n"
    answer, rows, _ = answer_of(
        workbench,
        tmp_path,
        text,
        "--max-correction-mm",
        "1e9",
        "--max-correction-deg",
        "1e9",
        status=status,
    )
    said = answer["warnings"] + [one["why"] for one in answer["refused"]]
    assert (words in " ".join(said)) if words else not said
    assert (rows[0]["q1_deg"] == "") == (status == 1)


def test_one_load_that_the_recording_does_not_state_is_its_load_and_counts_as_uncertain(
    workbench, tmp_path
):
    elastic(tmp_path / "arm", fitted_range=RANGE)
    targets = ("0,10,10,0,30,0", "5,15,10,0,40,0")
    without, rows, _ = answer_of(
        workbench, tmp_path, "\n".join((JOINTS, *targets)) + "\n", status=0
    )
    loaded = [f"{JOINTS},payload_kg", *(f"{target},3" for target in targets)]
    answer, same, _ = answer_of(workbench, tmp_path, "\n".join(loaded) + "\n", status=0)
    for one, other in zip(rows, same):
        assert one["q2_deg"] == other["q2_deg"]
        assert float(other["sigma_mm"]) > 0.1 > float(one["sigma_mm"])
    assert "states none: it is taken to have been made with the same load" in str(
        answer["warnings"]
    )
    answer, _, _ = answer_of(workbench, tmp_path, "\n".join(loaded) + "\n", "--max-sigma-mm", "0.1")
    assert len(answer["refused"]) == 2


def test_different_loads_are_refused_where_the_recording_states_none(workbench, tmp_path):
    elastic(tmp_path / "arm", fitted_range=RANGE)
    text = f"{JOINTS},payload_kg\n0,10,10,0,30,0,0\n5,15,10,0,40,0,3\n"
    answer, _, _ = answer_of(workbench, tmp_path, text)
    assert [one["row"] for one in answer["refused"]] == [2]
    assert "deflects the arm, and the recording states no load" in answer["refused"][0]["why"]


@pytest.mark.parametrize("cell", ["-1", "nan", "inf", "-inf"])
def test_a_load_that_cannot_be_is_a_sentence(workbench, tmp_path, cell):
    elastic(tmp_path / "arm")
    (tmp_path / "t.csv").write_text(f"{JOINTS},payload_kg\n0,10,10,0,30,0,{cell}\n")
    done = workbench("compensate", "arm", "t.csv")
    assert done.returncode == 2 and "t.csv, row 2, column payload_kg: expected" in done.stderr


def test_a_rigid_model_warns_of_a_load_that_it_does_not_know(workbench, tmp_path):
    solution(tmp_path / "arm")
    answer, _, _ = answer_of(
        workbench, tmp_path, f"{JOINTS},payload_kg\n0,10,10,0,30,0,40\n", status=0
    )
    assert any(
        "the load on the flange is outside" in one and "the arm may" in one
        for one in answer["warnings"]
    )


def test_one_load_for_targets_that_have_no_column(workbench, tmp_path):
    """A robot program has no columns; a table that states its loads takes none from the command line."""
    elastic(tmp_path / "arm")
    plain = f"{JOINTS}\n0,10,10,0,30,0\n"
    stated = f"{JOINTS},payload_kg\n0,10,10,0,30,0,2\n"
    (tmp_path / "t.csv").write_text(plain)
    done = workbench("compensate", "arm", "t.csv")
    assert (
        done.returncode == 2 and "state one load for all targets with --payload-kg" in done.stderr
    )
    _, by_option, _ = answer_of(workbench, tmp_path, plain, "--payload-kg", "2", status=0)
    _, by_column, _ = answer_of(workbench, tmp_path, stated, status=0)
    assert by_option[0]["q2_deg"] == by_column[0]["q2_deg"]
    (tmp_path / "t.csv").write_text(stated)
    done = workbench("compensate", "arm", "t.csv", "--payload-kg", "2")
    assert done.returncode == 2 and "omit the option or the column" in done.stderr
