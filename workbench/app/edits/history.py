"""Undo and redo of an edit session."""

from workbench.app.edits.changes import Change
from workbench.app.edits.session import Session


class History:
    """The session as it is, with what was undone. Every change forgets what was undone before it."""

    def __init__(self, session: Session):
        self.session = session
        self._undone: list[Change] = []

    def copy(self) -> "History":
        """The same session and the same undone changes, to be changed on their own."""
        copied = History(self.session)
        copied._undone = list(self._undone)
        return copied

    def apply(self, change: Change) -> Session:
        """Make one more change."""
        self._undone.clear()
        self.session = self.session.with_change(change)
        return self.session

    def undo(self) -> Session:
        """Take the last change back; nothing happens where there is none."""
        if self.session.changes:
            self._undone.append(self.session.changes[-1])
            self.session = self.session.without_last_change()
        return self.session

    def redo(self) -> Session:
        """Make the change again that was undone last; nothing happens where there is none."""
        if self._undone:
            self.session = self.session.with_change(self._undone.pop())
        return self.session

    @property
    def can_undo(self) -> bool:
        return bool(self.session.changes)

    @property
    def can_redo(self) -> bool:
        return bool(self._undone)
