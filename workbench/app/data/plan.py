"""Plan of the next calibration: stages and effects of the opened run with those that the session changes."""

from collections.abc import Iterable
from pathlib import Path

from workbench.app.data.opened import Opened
from workbench.app.edits.apply import labels_of
from workbench.app.edits.changes import ADDED, EFFECTS, STAGES, effect_label
from workbench.app.edits.session import CALIBRATE, Session
from workbench.core.errors import InputError
from workbench.core.text.structured_text import ContentError, read_json

DIAGNOSE = "diagnose"


def stage_items(
    opened: Opened, session: Session, earlier: Iterable[Opened] = ()
) -> tuple[list[dict], list[dict]]:
    """Stages and effects of the next calibration: name, why, whether it is included, and the `state` of a stage.

    They are those of an opened calibration with those that the session adds. A diagnosis builds a model of its own,
    whose effects are not those of the plan of the next calibration: none of them is listed.

    earlier: runs before the opened one; a stage that it left out is listed as long as the app runs.
    """
    out = session.excluded(STAGES)
    rows = {row["name"]: row for run in earlier for row in _stages(run)}
    fitted = {row["name"]: row for row in _stages(opened)}
    added = {ADDED} if session.added_effects else set()
    missing_keys = sorted((out | added) - rows.keys() - fitted.keys())
    stages = [
        {"name": name, "why": row.get("why", ""), "state": _state(fitted.get(name), name in out)}
        for name, row in (rows | fitted | {name: {} for name in missing_keys}).items()
    ]
    for stage in stages:
        stage["on"] = stage["name"] not in out
    left_out = session.excluded(EFFECTS)
    labels = [effect_label(row) for row in _effects(opened)]
    for row in session.added_effects:
        if not labels_of(row) & set(labels):
            labels.append(effect_label(row))
    labels += [name for name in sorted(left_out) if name not in labels]
    effects = [{"name": label, "on": label not in left_out} for label in labels]
    return stages, effects


def _stages(opened: Opened) -> list[dict]:
    return (opened.answer or {}).get("stages", [])


def _state(fitted: dict | None, is_excluded: bool) -> str:
    """State of a stage in the opened run; fitted: its row there, None where the run did not fit it."""
    if fitted is not None:
        return "retained" if fitted["earned"] else "not retained"
    return "excluded" if is_excluded else "part of the next run"


def plan_sentence(session: Session) -> str:
    """State which plan the next calibration uses."""
    if session.command != CALIBRATE:
        return ""
    name = session.plan or "the default plan"
    return f"Calibrate uses {name} with the changes of this session."


def _effects(opened: Opened) -> list[dict]:
    """Effects of the model of an opened calibration, [] without one. Raises InputError for a broken file."""
    path = opened.folder / "solution.json" if opened.folder else None
    if path is None or not path.is_file() or opened.command == DIAGNOSE:
        return []
    return _read_effects(path)


def _read_effects(path: Path) -> list[dict]:
    """Effects of a solution.json. Raises InputError where it cannot be read or holds none."""
    try:
        keys = read_json(path)
    except (OSError, ContentError) as problem:
        raise InputError(f"{path} cannot be read ({problem}); calibrate again") from None
    effects = keys.get("effects") if isinstance(keys, dict) else None
    if not isinstance(effects, list) or not all(map(_is_effect, effects)):
        raise InputError(
            f"{path}, key effects: expected a list of effects with effect and where, found {str(effects)[:60]}; "
            "calibrate again"
        )
    return effects


def _is_effect(row: object) -> bool:
    return isinstance(row, dict) and {"effect", "where"} <= row.keys()
