"""A question of the import: asked at a terminal, and a refusal with the line of the mapping file otherwise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from workbench.core.errors import InputError


@dataclass(frozen=True)
class Question:
    """Undecided question (`sentence`, without a full stop), the `options` in words, and the mapping `line` of each."""

    sentence: str
    options: tuple[str, ...]
    lines: tuple[str, ...]


Ask = Callable[[Question], int]
"""Returns the index of the chosen option."""


def refuse(question: Question) -> int:
    """Raise InputError with the line that answers the question."""
    line = question.lines[0] if question.lines else ""
    others = " (or the values of another option)" if len(question.lines) > 1 else ""
    remedy = f"; add {line}{others} to a mapping file and name it with --map" if line else ""
    raise InputError(
        f"{question.sentence}{remedy}; --propose FILE writes the mapping found so far."
    )


def choose(question: Question, ask: Ask | None, values: Sequence):
    """The value of the chosen option. Raises InputError where nobody can be asked."""
    return values[(ask or refuse)(question)]
