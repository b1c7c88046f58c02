"""The one error of everything that a user can get wrong in a file, and how its sentence is built."""

from workbench.core.errors import InputError

__all__ = ["InputError", "complaint"]


def complaint(where: str, expected: str, found: str, do: str) -> InputError:
    """The error, to be raised, that says what a user has to change.

    where: file, row and key ("cell-4/samples.csv, row 7, column q3_deg"); expected, found and do
    are parts of one sentence, without a full stop.
    """
    one_line = " ".join(f"{where}: expected {expected}, found {found}; {do}".split())
    return InputError(one_line + ".")
