"""State of the app without its page: the opened run, the selection and the edits."""

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from pathlib import Path

import numpy as np

from workbench.app.data.comparison import comparison_rows
from workbench.app.data.decimate import Histogram, is_within_ranges
from workbench.app.data.memo import Memo
from workbench.app.data.numbers import rows_of
from workbench.app.data.opened import Opened, newest_diagnosis, open_subject
from workbench.app.data.plan import DIAGNOSE
from workbench.app.data.prediction import lengths_by_number, predicted_lengths
from workbench.app.data.recorded_images.sample_images import sample_images
from workbench.app.data.summaries import Summaries
from workbench.app.edits.apply import kept_rows
from workbench.app.edits.changes import (
    ADD,
    EFFECTS,
    EXCLUDE,
    IMAGES,
    INCLUDE,
    KINDS,
    POSES,
    SAMPLES,
    Change,
)
from workbench.app.edits.excluded import (
    Excluded,
    excluded_items,
    excluded_numbers,
    excluded_pose_count,
)
from workbench.app.edits.history import History
from workbench.app.edits.session import CALIBRATE, Session
from workbench.app.edits.start import first_session
from workbench.app.jobs import DONE, RUNNING, Job
from workbench.core.errors import InputError

_MOST_KNOWN = 24
MOST_LISTED = 100
"""Excluded items that a list shows."""
REPLACE = "replace"
EXTEND = "extend"
REMOVE = "remove"


class Workspace:
    """One opened run or recording, the session of edits, the selection, and the reruns.

    opened: what `workbench open` opened; path: session.toml, which every change rewrites. Rows count the
    residuals' rows (m), or the samples where no run is open.
    """

    def __init__(self, opened: Opened, path: Path):
        self.path = Path(path)
        self.runs: list[Opened] = [opened]
        self.history = History(first_session(opened, self.path))
        self.job: Job | None = None
        self.diagnosis: Opened | None = opened if opened.command == DIAGNOSE else None
        self._has_looked = False
        self._select_none()

    @property
    def opened(self) -> Opened:
        """The newest run."""
        return self.runs[-1]

    @property
    def previous(self) -> Opened | None:
        """The run before the newest, for comparison; None where there is no other."""
        return self.runs[-2] if len(self.runs) > 1 else None

    @property
    def session(self) -> Session:
        return self.history.session

    @property
    def count(self) -> int:
        """m, number of rows."""
        return len(self.opened.rows)

    # Selection

    @property
    def selected_rows(self) -> np.ndarray:
        """Indices of the selected rows."""
        return np.flatnonzero(self.selected)

    def select(self, rows: Iterable[int], mode: str = REPLACE) -> None:
        """Select some rows; "extend" keeps what is selected, "remove" takes the rows away from it."""
        rows = self._checked(rows)
        if mode == REPLACE:
            self.selected[:] = False
        self.selected[rows] = mode != REMOVE
        if len(rows) and mode != REMOVE:
            self.current = int(rows[0])

    def select_box(self, name: str, x_range, y_range, kind: str = "", mode: str = REPLACE) -> None:
        """Select all samples in a rectangle of the chart of the residual over the quantity `name`."""
        x = self.quantities[name]
        y = self.lengths(kind)
        self.select(np.flatnonzero(is_within_ranges(x, y, x_range, y_range)), mode)

    def select_lengths(self, low: float, high: float, kind: str = "", mode: str = REPLACE) -> None:
        """Select all samples whose residual has a length from `low` to `high`, mm."""
        y = self.lengths(kind)
        self.select(np.flatnonzero((y >= low) & (y <= high)), mode)

    def clear_selection(self) -> None:
        """Select nothing."""
        self.selected[:] = False

    def select_sample(self, number: int, mode: str = REPLACE) -> None:
        """Select the rows of a sample by its number. Raises InputError for a number that is not there."""
        rows = np.flatnonzero(self.opened.edit_ids == number)
        if not len(rows):
            raise InputError(self._missing_sentence(number))
        self.select(rows, mode)

    def _missing_sentence(self, number: int) -> str:
        """Why a sample cannot be selected."""
        found = [item for item in self.excluded_items if number in item.samples]
        if not found:
            return f"Sample {number} is not among the residuals of this run; correct the number"
        return (
            f"Sample {number} is excluded and no part of this run, so that it has no residual here; include it in "
            "the list of excluded samples and calibrate again"
        )

    def image_index_of(self, number: int) -> int | None:
        """Place in images.csv of the image that shows a sample best; None without one."""
        return self._sample_images.get(number)

    @cached_property
    def _sample_images(self) -> dict[int, int]:
        """Number of a sample -> place in images.csv of the image that shows it best."""
        return sample_images(self.opened)

    def pose_of(self, row: int) -> int | None:
        """Number of the pose of a row: as the recording names it, else counted by the run; None without one."""
        numbers = self.opened.samples.columns.get("pose")
        if numbers is not None:
            return int(numbers[self.opened.rows[row]])
        found = self.opened.residuals
        return None if found is None or found.pose is None else int(found.pose[row])

    def row_of_image(self, index: int) -> int | None:
        """Row of the sample that the image at a place of images.csv belongs to; None without one."""
        number = self.opened.recording.images[index].get("sample")
        rows = np.flatnonzero(self.opened.edit_ids == number) if number is not None else ()
        return int(rows[0]) if len(rows) else None

    def image_of(self, number: int) -> str:
        """Name of the image that shows a sample best, "–" without one."""
        index = self.image_index_of(number)
        return "–" if index is None else self.opened.recording.images[index]["image"]

    def go_to(self, row: int) -> None:
        """Make a row the current one."""
        self.current = int(np.clip(row, 0, max(self.count - 1, 0)))

    # What is drawn

    @property
    def quantities(self) -> dict[str, np.ndarray]:
        """Label with unit -> (m,) values of everything that a residual can be drawn over."""
        return self.summaries.quantities

    def lengths(self, kind: str = "") -> np.ndarray:
        """(m,) mm, length of the residual of a kind, "" for the one that is shown; zeros without a run."""
        return self.summaries.lengths(kind)

    @property
    def kept(self) -> np.ndarray:
        """(m,) bool: rows that no change of the session excludes."""
        return self._memo(("kept", self.session.changes), self._find_kept)

    @property
    def excluded_rows(self) -> np.ndarray:
        """(k,) rows that a change of the session excludes, ascending."""
        return self._memo(
            ("excluded rows", self.session.changes), lambda: np.flatnonzero(~self.kept)
        )

    def _find_kept(self) -> np.ndarray:
        recording = self.opened.recording
        changed = self.session.excluded(SAMPLES) or self.session.excluded(POSES)
        if not recording.n or not changed:
            return np.ones(self.count, bool)
        is_included = np.append(kept_rows(self.session, recording), True)  # for row -1
        return is_included[self.opened.edit_rows]

    def drawn(self, max_marks: int, kind: str = "") -> np.ndarray:
        """Rows that a figure of at most about `max_marks` marks shows: the largest, and some evenly spread."""
        return self.summaries.drawn(max_marks, kind)

    def means(self, name: str, kind: str = "") -> tuple[np.ndarray, np.ndarray]:
        """Mean quantity and mean length of the residual, over bins of equal count, of the rows that are kept."""
        return self.summaries.means(name, kind, self.excluded_rows)

    def counts(self, kinds: Iterable[str]) -> Histogram:
        """Counts of the lengths of the residual of some kinds, of the rows that are kept."""
        kinds, excluded = tuple(kinds), self.excluded_rows
        return self._memo(
            ("counts", kinds, self.session.changes),
            lambda: self.summaries.counts(kinds, excluded),
        )

    # Edits

    def change(self, change: Change) -> None:
        """Make one change and write session.toml."""
        self._saved(lambda history: history.apply(change))

    def exclude_selected(self, why: str = "selected in the app") -> None:
        """Exclude the selected samples. Raises InputError where nothing is selected."""
        self.change(Change(EXCLUDE, SAMPLES, self._selected_ids(), why))
        self.clear_selection()

    def include_selected(self) -> None:
        """Include what is excluded of the selected samples, and their poses. Raises InputError for none."""
        selected = set(self._selected_ids())
        self._include([item for item in self.excluded_items if selected & set(item.samples)])

    def include_sample(self, number: int) -> int:
        """Include an excluded sample, and its pose where that is excluded; how many changes. Raises InputError."""
        found = [item for item in self.excluded_items if number in item.samples]
        self._include(found)
        return len(found)

    def include_item(self, kind: str, number: int) -> None:
        """Include one item of `excluded_items` by its kind and number. Raises InputError."""
        found = [item for item in self.excluded_items if item.kind == kind]
        self._include([item for item in found if item.number == number])

    def include_all(self) -> None:
        """Include all excluded samples and poses. Raises InputError where there are none."""
        self._include_numbers(
            {kind: sorted(self.session.excluded(kind)) for kind in (SAMPLES, POSES)}
        )

    def _include(self, items: Iterable[Excluded]) -> None:
        """Include some items."""
        items = list(items)
        kinds = (SAMPLES, POSES)
        self._include_numbers(
            {
                kind: [
                    n for exclusion in items if exclusion.kind == kind for n in exclusion.numbers
                ]
                for kind in kinds
            }
        )

    def _include_numbers(self, numbers: Mapping[str, list[int]]) -> None:
        """Include samples and poses by their numbers: one change for each kind. Raises InputError for none."""
        changes = [
            Change(INCLUDE, kind, tuple(chosen)) for kind, chosen in numbers.items() if chosen
        ]
        if not changes:
            raise InputError("None of these samples is excluded; there is nothing to include")
        self._saved(lambda history: [history.apply(change) for change in changes])

    @property
    def excluded_items(self) -> list[Excluded]:
        """Samples and poses that the session excludes, also those that are no part of the newest run."""
        session = self.session
        recording = self.opened.recording
        return self._memo(("excluded", session.changes), lambda: excluded_items(session, recording))

    @property
    def first_excluded(self) -> list[Excluded]:
        """The first of `excluded_items`, as many as a list shows."""
        session = self.session
        recording = self.opened.recording
        key = ("first excluded", session.changes)
        return self._memo(
            key, lambda: excluded_items(session, recording, MOST_LISTED)[:MOST_LISTED]
        )

    @property
    def excluded_counts(self) -> dict[str, int]:
        """Number of samples, and number of poses, that the session excludes."""
        session = self.session
        recording = self.opened.recording

        def compute():
            samples = len(session.excluded(SAMPLES))
            return {SAMPLES: samples, POSES: excluded_pose_count(session, recording)}

        return self._memo(("excluded counts", session.changes), compute)

    @property
    def excluded_outside_run(self) -> int:
        """Number of excluded samples that are no part of the newest run."""

        def compute():
            numbers = excluded_numbers(self.session, self.opened.recording)
            if not numbers.size:  # the numbers of a large recording are not sorted for nothing
                return 0
            return int((~rows_of(self.opened.edit_ids, numbers)[1]).sum())

        return self._memo(("outside", self.session.changes), compute)

    def lengths_of(self, items: Iterable[Excluded]) -> list[float | None]:
        """mm, largest residual of the samples of each item: of the run, else predicted by its model; None without."""
        items = list(items)
        numbers = [number for item in items for number in item.samples]
        known = lengths_by_number(self.opened, numbers)
        if not known.keys() >= set(numbers):
            known = self._memo(("predicted",), lambda: predicted_lengths(self.opened)) | known
        found = [[known[number] for number in item.samples if number in known] for item in items]
        return [max(lengths, default=None) for lengths in found]

    def exclude_poses(self, why: str = "poses of the selected samples") -> None:
        """Exclude the poses of the selected samples. Raises InputError where nothing is selected."""
        self.change(Change(EXCLUDE, POSES, self._selected_ids(), why))
        self.clear_selection()

    def exclude_above(self, threshold: float) -> int:
        """Exclude all samples whose residual is longer than `threshold`, mm; how many. Raises InputError."""
        rows_above = np.flatnonzero(self.kept & (self.lengths() > threshold))
        if not len(rows_above):
            raise InputError(
                f"No sample has a residual above {threshold:g} mm; lower the threshold"
            )
        ids = tuple(np.unique(self.opened.edit_ids[rows_above]).tolist())
        self.change(Change(EXCLUDE, SAMPLES, ids, f"residual above {threshold:.4g} mm"))
        return len(rows_above)

    def set_items(self, kind: str, items: Iterable[str], is_included: bool) -> None:
        """Include or exclude images, stages or effects by name."""
        names = tuple(sorted(items))
        if kind in KINDS and names:
            self.change(Change(INCLUDE if is_included else EXCLUDE, kind, names))

    def set_image(self, index: int, is_included: bool) -> None:
        """Include or exclude the image at a place of images.csv."""
        self.set_items(IMAGES, [self.opened.recording.images[index]["image"]], is_included)

    def add_effects(self, rows: list[dict], why: str) -> None:
        """Add effects to the plan. Raises InputError where there are none."""
        if not rows:
            raise InputError("No term is ticked that a plan can hold; tick at least one")
        self.change(Change(ADD, EFFECTS, tuple(rows), why))

    def undo(self) -> None:
        """Take the last change back."""
        self._saved(History.undo)

    def redo(self) -> None:
        """Make the last change again that was taken back."""
        self._saved(History.redo)

    # Reruns

    @property
    def is_busy(self) -> bool:
        """Whether a run is in progress."""
        return self.job is not None and self.job.state == RUNNING

    def start(self, command: str = CALIBRATE) -> Job:
        """Start a rerun in the background: `workbench COMMAND --session`, or a diagnosis of what is not excluded."""
        if self.is_busy:
            raise InputError("A run is in progress; wait for it or cancel it")
        self._save()
        folder = self.path.parent.resolve()
        command = DIAGNOSE if command == DIAGNOSE else self.session.command
        words = [command, "--session", str(self.path.resolve())]
        self.job = Job(words, self._free_folder(folder, command), folder)
        return self.job

    def finish(self) -> bool:
        """Open the run of a job that is done; whether there was one."""
        if self.job is None or self.job.state != DONE:
            return False
        out, self.job = self.job.out, None
        subject = open_subject(str(out))
        if subject.command == DIAGNOSE:
            self.diagnosis = subject
        else:
            self.open_run(subject)
        return True

    def look_for_diagnosis(self) -> None:
        """Open the newest earlier diagnosis of the same data where none is open; looks once."""
        if self.diagnosis is None and not self._has_looked:
            self._has_looked = True
            self.diagnosis = newest_diagnosis(self.opened)

    def open_run(self, opened: Opened) -> None:
        """Show another run of the same recording; the selection is lost."""
        self.runs.append(opened)
        self.__dict__.pop("_sample_images", None)
        self._select_none()

    def comparison(self) -> list[dict]:
        """One row a figure of the newest run and the one before: name, before, after; [] without two runs."""
        if self.previous is None:
            return []
        return comparison_rows(self.previous, self.opened, self.session.command)

    # Inside

    def _select_none(self) -> None:
        self.summaries = Summaries(self.opened)
        self._memo = Memo(_MOST_KNOWN).get
        self.selected = np.zeros(self.count, bool)
        self.current = 0

    def _selected_ids(self) -> tuple[int, ...]:
        rows = self.selected_rows
        if not len(rows):
            raise InputError("No sample is selected; click or brush some first")
        return tuple(np.unique(self.opened.edit_ids[rows]).tolist())

    def _checked(self, rows: Iterable[int]) -> np.ndarray:
        rows = np.asarray(list(rows) if not isinstance(rows, np.ndarray) else rows)
        if rows.size and (
            rows.dtype.kind not in "iu" or rows.min() < 0 or rows.max() >= self.count
        ):
            raise InputError(f"expected rows from 0 to {self.count - 1}, found others")
        return rows.astype(int)

    def _save(self) -> None:
        """Write session.toml. Raises InputError where the folder cannot be written."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as problem:
            raise InputError(
                f"{self.path.parent}: expected a folder that can be written, found '{problem.strerror}'; start "
                "workbench open in another folder or name a file with --session"
            ) from None
        self.session.save(self.path)

    def _saved(self, edit: Callable) -> None:
        """Edit the session and write it; where it cannot be written nothing changes. Raises InputError."""
        before = self.history
        self.history = before.copy()
        try:
            edit(self.history)
            self._save()
        except InputError:
            self.history = before
            raise

    @staticmethod
    def _free_folder(folder: Path, command: str) -> Path:
        number = 1
        while (folder / f"{command}-{number}").exists():
            number += 1
        return folder / f"{command}-{number}"
