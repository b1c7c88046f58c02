"""Edit sessions of the app: changes, undo, session.toml, and what they do to recordings and plans."""

import json

import numpy as np
import pytest

import datasets
from workbench.app.edits.apply import EditedPlan, edited_recording, effect_row, kept_rows
from workbench.app.edits.changes import ADD, EXCLUDE, INCLUDE, Change, effect_label
from workbench.app.edits.history import History
from workbench.app.edits.session import Session, read_session
from workbench.core.errors import InputError
from workbench.core.solution import Stage


@pytest.fixture(scope="module")
def board_recording(tmp_path_factory):
    """A recording of eight images of a chessboard, rendered by a pinhole camera."""
    import cv2

    folder = tmp_path_factory.mktemp("board")
    (folder / "images").mkdir()
    matrix = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
    rows = ["image,role,placement"]
    rng = np.random.default_rng(4)
    for k in range(8):
        turn, shift = (
            cv2.Rodrigues(rng.uniform(-0.45, 0.45, 3))[0],
            np.array([-45.0, -30, 170 + 8 * k]),
        )
        image = np.full((480, 640), 200, np.uint8)
        for i in range(10):
            for j in range(7):
                square = np.array(
                    [[i, j, 0], [i + 1, j, 0], [i + 1, j + 1, 0], [i, j + 1, 0]]
                ) * 10.0 - [10, 10, 0]
                seen = matrix @ (turn @ (square - [35, 25, 0]).T + (shift + [45, 30, 0])[:, None])
                corners = np.round(16 * (seen[:2] / seen[2]).T).astype(int)
                cv2.fillConvexPoly(image, corners, 30 if (i + j) % 2 == 0 else 230, cv2.LINE_AA, 4)
        cv2.imwrite(str(folder / "images" / f"{k}.png"), cv2.GaussianBlur(image, (0, 0), 0.8))
        rows.append(f"images/{k}.png,board,{k}")
    (folder / "images.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    board = "[board]\nkind = 'chessboard'\ncolumns = 9\nrows = 6\nsquare_mm = 10.0\n"
    head = "format = 'recording/1'\nmeasures = 'board-images'\n[images]\nfile = 'images.csv'\n"
    (folder / "recording.toml").write_text(head + board, encoding="utf-8")
    return folder


CHANGES = (
    Change(EXCLUDE, "samples", (3, 7), 'residual above 0.2 mm, "large"'),
    Change(EXCLUDE, "poses", (12,)),
    Change(EXCLUDE, "stages", ("drift",)),
    Change(EXCLUDE, "effects", ("transmission-harmonic at joint-3 (order=2)",)),
    Change(INCLUDE, "samples", (7,)),
    Change(ADD, "effects", ({"effect": "joint-compliance", "where": "joint-2"},), "diagnosis"),
)


def test_session_file_holds_every_change_on_a_line_and_is_read_back_equal(tmp_path):
    session = Session("elastic-arm", "my plan.toml", "", 7, True, CHANGES)
    session.save(tmp_path / "session.toml")
    assert read_session(tmp_path / "session.toml") == session
    text = (tmp_path / "session.toml").read_text(encoding="utf-8")
    assert sum(line.startswith("  { action") for line in text.splitlines()) == len(CHANGES)


@pytest.mark.parametrize(
    "text",
    ["back\\slash", 'quote "', "new\nline", "control \x7f", "Umlaut ä", "'''", "{{ 1 + 1 }}"],
)
def test_any_text_survives_session_toml(tmp_path, text):
    session = Session("a", changes=(Change(EXCLUDE, "images", (text,), text),))
    session.save(tmp_path / "session.toml")
    assert read_session(tmp_path / "session.toml") == session


def test_excluded_items_follow_the_order_of_changes():
    session = Session("a", changes=CHANGES)
    assert session.excluded("samples") == {3}
    assert session.excluded("stages") == {"drift"}
    assert session.added_effects == ({"effect": "joint-compliance", "where": "joint-2"},)


def test_undo_and_redo_restore_sessions_and_a_new_change_forgets_what_was_undone():
    history = History(Session("a"))
    states = [history.session]
    for change in CHANGES:
        states.append(history.apply(change))
    for state in reversed(states[:-1]):
        assert history.undo() == state
    assert not history.can_undo and history.undo() == states[0]
    for state in states[1:]:
        assert history.redo() == state
    assert not history.can_redo
    history.undo()
    history.apply(Change(EXCLUDE, "samples", (1,)))
    assert not history.can_redo


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("format = 'session/2'", "key format"),
        ("format = 'session/1'", "key recording"),
        ("format = 'session/1'\nrecording = 3", "key recording"),
        ("format = 'session/1'\nrecording = 'a'\nfolds = 1", "key folds"),
        ("format = 'session/1'\nrecording = 'a'\nfolds = true", "key folds"),
        ("format = 'session/1'\nrecording = 'a'\nrun = 'rm'", "'run'"),
        ("format = 'session/1'\nrecording = 'a'\nchanges = [3]", "change 1"),
        ("format = 'session/1'\nrecording = 'a'\nchanges = [{action = 'delete'}]", "key action"),
        (
            "format = 'session/1'\nrecording = 'a'\nchanges = [{action = 'exclude', kind = 'files'}]",
            "key kind",
        ),
        (
            "format = 'session/1'\nrecording = 'a'\nchanges = [{action = 'exclude', kind = 'samples', items = []}]",
            "key items",
        ),
        (
            "format = 'session/1'\nrecording = 'a'\nchanges = [{action = 'exclude', kind = 'samples', items = ['1']}]",
            "sample numbers",
        ),
        (
            "format = 'session/1'\nrecording = 'a'\nchanges = [{action = 'add', kind = 'stages', items = ['x']}]",
            "key kind",
        ),
        (
            "format = 'session/1'\nrecording = 'a'\nchanges = [{action = 'add', kind = 'effects', items = [{effect = 'os.system', where = 'joint-1'}]}]",
            "os.system",
        ),
        ("not toml", "cannot be read"),
    ],
)
def test_broken_session_files_are_refused_with_file_and_key(tmp_path, text, words):
    path = tmp_path / "session.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as problem:
        read_session(path)
    assert words in str(problem.value) and str(path) in str(problem.value)


def test_excluded_poses_take_all_their_samples_along():
    recording = datasets.read("elastic-arm")
    label = np.bincount(recording.poses).argmax()
    ids = recording.sample_ids[recording.poses == label]
    session = Session("elastic-arm", changes=(Change(EXCLUDE, "poses", (int(ids[0]),)),))
    assert set(recording.sample_ids[~kept_rows(session, recording)]) == set(ids.tolist())


def test_samples_that_do_not_exist_are_refused():
    recording = datasets.read("elastic-arm")
    session = Session("elastic-arm", changes=(Change(EXCLUDE, "samples", (10_000,)),))
    with pytest.raises(InputError, match="10000"):
        edited_recording(session, recording)


def test_excluding_every_sample_is_refused():
    recording = datasets.read("elastic-arm")
    everything = tuple(recording.sample_ids.tolist())
    with pytest.raises(InputError, match="all 300 samples"):
        edited_recording(
            Session("elastic-arm", changes=(Change(EXCLUDE, "samples", everything),)), recording
        )


def _stages():
    harmonics = tuple(("transmission-harmonic", "joint-3", {"order": order}) for order in (1, 2))
    drift = Stage("drift", "", (("base-drift", "base", {"start": 0.0, "end": 1.0}),))
    return (
        Stage("geometry", "", free=("base.*",), earn=False),
        Stage("transmission", "", harmonics),
        drift,
    )


def test_plan_without_stages_and_effects_and_with_added_ones():
    stages = EditedPlan(Session("a", changes=CHANGES)).edited(_stages())
    assert [stage.name for stage in stages] == ["geometry", "transmission", "added effects"]
    assert stages[1].effects == (("transmission-harmonic", "joint-3", {"order": 1}),)
    assert stages[2].effects == (("joint-compliance", "joint-2", {}),)


def test_a_stage_whose_effects_are_all_excluded_disappears():
    label = effect_label({"effect": "base-drift", "where": "base", "start": 0.0, "end": 1.0})
    session = Session("a", changes=(Change(EXCLUDE, "effects", (label,)),))
    assert [stage.name for stage in EditedPlan(session).edited(_stages())] == [
        "geometry",
        "transmission",
    ]


_HARMONIC = {"effect": "transmission-harmonic", "where": "joint-3", "order": 2}


def _names_and_labels(*changes):
    stages = EditedPlan(Session("a", changes=changes)).edited(_stages())
    rows = [row for stage in stages for row in stage.effects]
    return [stage.name for stage in stages], [effect_label(effect_row(row)) for row in rows]


def test_an_added_effect_can_be_excluded_by_its_label_and_by_its_stage():
    label = "joint-compliance at joint-2"
    add = Change(ADD, "effects", ({"effect": "joint-compliance", "where": "joint-2"}, _HARMONIC))
    names, labels = _names_and_labels(add, Change(EXCLUDE, "effects", (label,)))
    assert "added effects" in names and label not in labels
    without_effects = Change(EXCLUDE, "effects", (label, effect_label(_HARMONIC)))
    names, labels = _names_and_labels(add, without_effects)
    assert "added effects" not in names and effect_label(_HARMONIC) not in labels
    without_stage = Change(EXCLUDE, "stages", ("added effects",))
    names, labels = _names_and_labels(add, without_stage)
    assert "added effects" not in names and label not in labels
    names, labels = _names_and_labels(add, without_stage, add)
    assert "added effects" in names and label in labels


def test_an_effect_is_excluded_by_the_label_with_all_options_that_a_solution_states():
    label = "base-drift at base (end=1, order=3, start=0)"
    names, _ = _names_and_labels(Change(EXCLUDE, "effects", (label,)))
    assert "drift" not in names


def test_an_exclusion_applies_to_effects_that_a_stage_chooses_during_the_fit():
    def choose(model, parameters):
        return tuple(
            ("joint-curve", f"joint-{k}", {"start": -1.0, "end": 1.0, "terms": 7}) for k in (1, 2)
        )

    label = "joint-curve at joint-1 (end=1, start=-1, terms=15)"
    session = Session("a", changes=(Change(EXCLUDE, "effects", (label,)),))
    plan = (*_stages(), Stage("joint curves", "", choose=choose))
    stage = EditedPlan(session).edited(plan)[-1].chosen_for(None, None)
    assert [where for _, where, _ in stage.effects] == ["joint-2"]


def test_unknown_stages_and_effects_are_refused():
    for kind in ("stages", "effects"):
        session = Session("a", changes=(Change(EXCLUDE, kind, ("no such",)),))
        with pytest.raises(InputError, match="no such"):
            EditedPlan(session).edited(_stages())


def _without_date(folder):
    answer = json.loads((folder / "answer.json").read_text(encoding="utf-8"))
    answer.pop("run")
    answer["provenance"].pop("date")
    return answer


@pytest.mark.slow
def test_a_session_is_repeated_from_the_command_line_with_an_identical_result(tmp_path, workbench):
    session = Session("elastic-arm", changes=(CHANGES[0], CHANGES[2], CHANGES[5]))
    session.save(tmp_path / "session.toml")
    for name in ("first", "second"):
        done = workbench("calibrate", "--session", "session.toml", "--out", name, "--no-report")
        assert done.returncode == 0, done.stderr
        again = tmp_path / name / "session.toml"
        (tmp_path / "session.toml").write_bytes(again.read_bytes())
    first, second = (_without_date(tmp_path / name) for name in ("first", "second"))
    assert first == second
    assert first["samples"] == 298
    assert "drift" not in [stage["name"] for stage in first["stages"]]
    assert (tmp_path / "first" / "residuals.csv").read_bytes() == (
        tmp_path / "second" / "residuals.csv"
    ).read_bytes()


def test_a_session_and_a_recording_exclude_one_another(tmp_path, workbench):
    Session("elastic-arm").save(tmp_path / "session.toml")
    done = workbench("calibrate", "elastic-arm", "--session", "session.toml")
    assert done.returncode == 2 and "RECORDING" in done.stderr
    done = workbench("calibrate")
    assert done.returncode == 2 and "--session" in done.stderr


def test_a_session_of_a_camera_leaves_images_out(tmp_path, workbench, board_recording):
    names = [row["image"] for row in datasets.read(board_recording).images]
    excluded = Change(EXCLUDE, "images", (names[0],))
    Session(str(board_recording), changes=(excluded,), command="camera").save(
        tmp_path / "session.toml"
    )
    done = workbench("camera", "--session", "session.toml", "--out", "run", "--no-report")
    assert done.returncode == 0, done.stderr
    answer = json.loads((tmp_path / "run" / "answer.json").read_text(encoding="utf-8"))
    assert names[0] not in [row["image"] for row in answer["images"]]
    assert len(answer["images"]) + len(answer["rejected"]) == len(names) - 1
    assert read_session(tmp_path / "run" / "session.toml").command == "camera"
    done = workbench("calibrate", "--session", "session.toml")
    assert done.returncode == 2 and "workbench camera --session" in done.stderr


def test_a_camera_needs_a_recording_or_a_session(workbench):
    done = workbench("camera")
    assert done.returncode == 2 and "--session" in done.stderr
