"""Samples and poses that a session excludes, one by one with the reason, so that each can be included again."""

from dataclasses import dataclass

import numpy as np

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


def excluded_items(session: Session, recording) -> list[Excluded]:
    """Excluded samples, then excluded poses, each in ascending order of their numbers."""
    reasons = _reasons(session)
    samples = [
        Excluded(SAMPLES, (number,), (number,), reasons[SAMPLES, number])
        for number in sorted(session.excluded(SAMPLES))
    ]
    return samples + _excluded_poses(session, recording, reasons)


def _reasons(session: Session) -> dict[tuple[str, int], str]:
    """(kind, number) -> why the last change excluded it."""
    found: dict[tuple[str, int], str] = {}
    for change in session.changes:
        if change.action == EXCLUDE and change.kind in (SAMPLES, POSES):
            found |= {(change.kind, number): change.why for number in change.items}
    return found


def _excluded_poses(session: Session, recording, reasons) -> list[Excluded]:
    """One item for each excluded pose, by the first number that was given for it."""
    given = np.array(sorted(session.excluded(POSES)), int)
    if not len(given):
        return []
    ids, labels = recording.sample_ids, recording.poses
    is_given = np.isin(ids, given)
    found = []
    for label in dict.fromkeys(labels[is_given].tolist()):
        is_here = labels == label
        numbers = tuple(sorted(ids[is_here & is_given].tolist()))
        samples = tuple(ids[is_here].tolist())
        found.append(Excluded(POSES, numbers, samples, reasons[POSES, numbers[0]]))
    return found
