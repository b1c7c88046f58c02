"""Samples and poses that a session excludes, one by one with the reason, so that each can be included again."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

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


def excluded_items(session: Session, recording, most: int | None = None) -> list[Excluded]:
    """Excluded samples, then excluded poses, each in ascending order of their numbers.

    most: how many samples are wanted, None for all. A brush excludes up to a million; a list shows a hundred.
    """
    numbers = sorted(session.excluded(SAMPLES))[:most]
    reasons = _reasons(session, SAMPLES, numbers)
    samples = [Excluded(SAMPLES, (number,), (number,), reasons[number]) for number in numbers]
    return samples + _excluded_poses(session, recording)


def excluded_numbers(session: Session, recording) -> np.ndarray:
    """(k,) numbers of all samples that are left out, those of excluded poses too."""
    if session.excluded(POSES):
        return recording.sample_ids[~kept_rows(session, recording)]
    samples = session.excluded(SAMPLES)
    return np.fromiter(samples, int, len(samples))


def _reasons(session: Session, kind: str, numbers: Iterable[int]) -> dict[int, str]:
    """Number -> why the last change excluded it."""
    wanted = frozenset(numbers)
    found: dict[int, str] = {}
    for change in session.changes:
        if (change.action, change.kind) == (EXCLUDE, kind):
            found |= dict.fromkeys(wanted.intersection(change.items), change.why)
    return found


def _excluded_poses(session: Session, recording) -> list[Excluded]:
    """One item for each excluded pose, by the first number that was given for it."""
    given = np.array(sorted(session.excluded(POSES)), int)
    if not len(given):
        return []
    reasons = _reasons(session, POSES, given.tolist())
    ids, labels = recording.sample_ids, recording.poses
    is_given = np.isin(ids, given)
    found = []
    for label in dict.fromkeys(labels[is_given].tolist()):
        is_here = labels == label
        numbers = tuple(sorted(ids[is_here & is_given].tolist()))
        samples = tuple(ids[is_here].tolist())
        found.append(Excluded(POSES, numbers, samples, reasons[numbers[0]]))
    return found
