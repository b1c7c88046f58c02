"""Samples and poses that a session excludes, one by one with the reason, so that each can be included again."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from workbench.app.data.numbers import rows_of
from workbench.app.edits.apply import kept_rows
from workbench.app.edits.changes import EXCLUDE, POSES, SAMPLES
from workbench.app.edits.session import Session


@dataclass(frozen=True)
class Excluded:
    """One excluded item: a sample, or a pose with all its samples.

    `kind`: "samples" or "poses"; `numbers`: the items of the session that stand for it, first the one that names it
    (two samples of one pose may both have been given); `samples`: numbers of the samples that are left out because
    of it; `why`: the reason of the last change that excluded it.
    """

    kind: str
    numbers: tuple[int, ...]
    samples: tuple[int, ...]
    why: str

    @property
    def number(self) -> int:
        """The number that names the item."""
        return self.numbers[0]


def excluded_items(session: Session, recording, max_count: int | None = None) -> list[Excluded]:
    """Excluded samples, then excluded poses, each in ascending order of their numbers.

    max_count: largest number of samples and of poses that are listed, None for all. A selection in a plot may exclude a
    million; a list shows a hundred.
    """
    numbers = sorted(session.excluded(SAMPLES))[:max_count]
    reasons = _reasons(session, SAMPLES, numbers)
    samples = [Excluded(SAMPLES, (number,), (number,), reasons[number]) for number in numbers]
    return samples + _excluded_poses(session, recording, max_count)


def excluded_numbers(session: Session, recording) -> np.ndarray:
    """(k,) numbers of all samples that are left out, those of excluded poses too."""
    if session.excluded(POSES):
        return recording.sample_ids[~kept_rows(session, recording)]
    samples = session.excluded(SAMPLES)
    return np.fromiter(samples, int, len(samples))


def _reasons(session: Session, kind: str, numbers: Iterable[int]) -> dict[int, str]:
    """Number -> why the last change excluded it."""
    row_numbers = frozenset(numbers)
    found: dict[int, str] = {}
    for change in session.changes:
        if (change.action, change.kind) == (EXCLUDE, kind):
            found |= dict.fromkeys(row_numbers.intersection(change.items), change.why)
    return found


def excluded_pose_count(session: Session, recording) -> int:
    """Number of poses that a session excludes, however many of their samples it names."""
    return len(np.unique(_given_poses(session, recording)[1]))


def _given_poses(session: Session, recording) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of samples (k,) that stand for excluded poses, in the order of the recording, and labels of the poses."""
    given = np.fromiter(session.excluded(POSES), int)
    if not len(given):
        return given, given
    rows, is_there = rows_of(recording.sample_ids, given)
    order = np.argsort(rows[is_there])
    return given[is_there][order], recording.poses[rows[is_there][order]]


def _excluded_poses(session: Session, recording, max_count: int | None) -> list[Excluded]:
    """One item for each excluded pose, by the first number that was given for it; the first `max_count` poses."""
    given, given_labels = _given_poses(session, recording)
    in_order = list(dict.fromkeys(given_labels.tolist()))[:max_count]
    if not in_order:
        return []
    labels = recording.poses
    is_listed = np.zeros(labels.max() + 1, bool)
    is_listed[in_order] = True
    listed_samples = np.flatnonzero(is_listed[labels])
    is_shown = is_listed[given_labels]
    samples_at = _numbers_by_label(labels[listed_samples], recording.sample_ids[listed_samples])
    given_at = _numbers_by_label(given_labels[is_shown], given[is_shown])
    reasons = _reasons(session, POSES, given[is_shown].tolist())
    found = []
    for label in in_order:
        numbers = tuple(sorted(given_at[label]))
        found.append(Excluded(POSES, numbers, tuple(samples_at[label]), reasons[numbers[0]]))
    return found


def _numbers_by_label(labels: np.ndarray, numbers: np.ndarray) -> dict[int, list[int]]:
    """Label -> numbers of the rows with that label, in the order of the rows."""
    found: dict[int, list[int]] = {}
    for label, number in zip(labels.tolist(), numbers.tolist()):
        found.setdefault(label, []).append(number)
    return found
