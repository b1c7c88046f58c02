"""An edit session: which recording is calibrated with which options, and the changes made, in order.

`session.toml` holds all of it. `workbench calibrate --session FILE` repeats the calibration without the app.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from workbench.app.edits.changes import (
    ADD,
    ADDED,
    EFFECTS,
    EXCLUDE,
    KINDS,
    STAGES,
    Change,
    change_line,
    effect_label,
    read_change,
)
from workbench.core.errors import InputError
from workbench.core.text.structured_text import ContentError, read_toml
from workbench.files.runs import RUNS, replace_file, slug

CALIBRATE = "calibrate"
CAMERA = "camera"
HAND_EYE = "handeye"
COMMANDS = (CALIBRATE, CAMERA, HAND_EYE)
"""Commands that repeat a session."""
KINDS_OF_HAND_EYE = ("in-hand", "to-hand")
FORMAT = "session/1"
NAME = "session.toml"
_TYPES = {
    "format": str,
    "command": str,
    "recording": str,
    "plan": str,
    "scanner": str,
    "camera": str,
    "kind": str,
    "folds": int,
    "trust_data": bool,
    "changes": list,
}


@dataclass(frozen=True)
class Session:
    """Settings and changes that `workbench calibrate --session` applies.

    `recording`: folder or known name; `plan`, `scanner` and `camera`: files, "" for none; `folds` of the
    cross-validation; `changes` in the order in which they were made; `command` "calibrate", "camera" or "handeye";
    `kind` of a hand-eye calibration, "in-hand" or "to-hand", "" as the recording says.
    """

    recording: str
    plan: str = ""
    scanner: str = ""
    folds: int = 10
    trust_data: bool = False
    changes: tuple[Change, ...] = ()
    command: str = CALIBRATE
    camera: str = ""
    kind: str = ""

    def with_change(self, change: Change) -> "Session":
        """The session with one more change."""
        return replace(self, changes=(*self.changes, change))

    def without_last_change(self) -> "Session":
        """The session before its last change; itself where there is none."""
        return replace(self, changes=self.changes[:-1])

    def excluded(self, kind: str) -> frozenset:
        """Items of a kind that are excluded after all changes."""
        if kind not in KINDS:
            raise ValueError(f"unknown kind {kind!r}")
        known = self._excluded_by_kind
        if kind not in known:
            known[kind] = self._find_excluded(kind)
        return known[kind]

    @cached_property
    def _excluded_by_kind(self) -> dict[str, frozenset]:
        """Cached result of `excluded`: a brush excludes up to a million samples."""
        return {}

    def _find_excluded(self, kind: str) -> frozenset:
        found: set = set()
        for change in self.changes:
            if change.action == ADD:
                found -= _included_by(change, kind)
            elif change.kind == kind:
                items = set(change.items)
                found = found | items if change.action == EXCLUDE else found - items
        return frozenset(found)

    @property
    def added_effects(self) -> tuple[dict, ...]:
        """Effects that changes add to the plan, each once, in order."""
        rows = [
            dict(row) for change in self.changes if change.action == ADD for row in change.items
        ]
        return tuple(row for k, row in enumerate(rows) if row not in rows[:k])

    def as_toml(self) -> str:
        """The text of session.toml: one line for each change."""
        import tomli_w

        head = tomli_w.dumps(self._head_keys())
        lines = [f"  {change_line(change)},\n" for change in self.changes]
        note = f"# Repeat without the app: workbench {self.command} --session FILE\n"
        return f"{note}{head}changes = [\n{''.join(lines)}]\n"

    def _head_keys(self) -> dict:
        """All keys but the changes; of the options of single commands those that are set."""
        head = {
            "format": FORMAT,
            "command": self.command,
            "recording": self.recording,
            "folds": self.folds,
            "trust_data": self.trust_data,
        }
        texts = {
            "plan": self.plan,
            "scanner": self.scanner,
            "camera": self.camera,
            "kind": self.kind,
        }
        return head | {key: value for key, value in texts.items() if value}

    def save(self, path: Path) -> None:
        """Write session.toml at `path`, replacing an earlier one. Raises InputError."""
        replace_file(Path(path), self.as_toml())


def _included_by(change: Change, kind: str) -> set[str]:
    """Items of a kind that a change includes by adding effects: their labels and the stage that holds them."""
    if kind == STAGES:
        return {ADDED}
    return {effect_label(row) for row in change.items} if kind == EFFECTS else set()


def session_path(subject: str, command: str = "") -> Path:
    """Path of the edits of a recording: a folder of its own under runs/.

    command: the command of the opened run. Edits of a hand-eye calibration and of the camera calibration of the same
    images are separate files.
    """
    words = f"{slug(subject)}-{HAND_EYE}" if command == HAND_EYE else slug(subject)
    return RUNS / f"{words}-session" / NAME


def read_session(path: Path, command: str = "") -> Session:
    """The session of a session.toml. Raises InputError with the file, the key and what to do.

    command: the command that repeats it, "" where any will do.
    """
    path = Path(path)
    try:
        keys = read_toml(path)
    except (OSError, ContentError) as problem:
        raise InputError(
            f"session {path} cannot be read ({problem}); name a session.toml of `workbench open`"
        ) from None
    if keys.get("format") != FORMAT:
        found = keys.get("format")
        raise InputError(
            f"session {path}, key format: expected '{FORMAT}', found {found!r}; name a session.toml"
        )
    for key, value in keys.items():
        _check_key(path, key, value)
    _check_command(path, keys, command)
    if not keys.get("recording"):
        raise InputError(
            f"session {path}, key recording: expected a folder or a known name, found none; add it"
        )
    if keys.get("folds", 2) < 2:
        raise InputError(
            f"session {path}, key folds: expected at least 2, found {keys['folds']}; correct it"
        )
    changes = [
        read_change(row, f"session {path}, change {k}")
        for k, row in enumerate(keys.get("changes", []), 1)
    ]
    options = {key: value for key, value in keys.items() if key not in ("format", "changes")}
    return Session(**options, changes=tuple(changes))


def _check_command(path: Path, keys: Mapping, command: str) -> None:
    found = keys.get("command", CALIBRATE)
    if found not in COMMANDS:
        expected = f"{', '.join(COMMANDS[:-1])} or {COMMANDS[-1]}"
        raise InputError(
            f"session {path}, key command: expected {expected}, found '{found}'; correct it"
        )
    if keys.get("kind", KINDS_OF_HAND_EYE[0]) not in KINDS_OF_HAND_EYE:
        expected = " or ".join(KINDS_OF_HAND_EYE)
        raise InputError(
            f"session {path}, key kind: expected {expected}, found '{keys['kind']}'; correct it"
        )
    if command and found != command:
        raise InputError(
            f"session {path}, key command: expected '{command}', found '{found}'; use workbench {found} --session"
        )


def _check_key(path: Path, key: str, value) -> None:
    if key not in _TYPES:
        raise InputError(
            f"session {path}: expected the keys {', '.join(_TYPES)}, found '{key}'; remove or rename it"
        )
    if type(value) is not _TYPES[key]:
        kind = {str: "text", int: "a whole number", bool: "true or false", list: "a list"}[
            _TYPES[key]
        ]
        raise InputError(f"session {path}, key {key}: expected {kind}, found {value!r}; correct it")
