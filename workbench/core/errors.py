"""Exceptions for unusable input and for interrupted work that can be continued."""


class InputError(ValueError):
    """Input that cannot be used.

    The message is one sentence that names the file, the row or key, what was expected, what was
    found and what to do; a command prints it and ends with status 2.

    Examples:
        >>> try:
        ...     wb.read("no-such-recording")
        ... except wb.InputError as error:
        ...     print("no-such-recording" in str(error))
        True

    `example`: lines of a file that would be right, which a command prints below the sentence.
    """

    def __init__(self, sentence: str, example: str = ""):
        super().__init__(sentence if sentence.endswith(".") else f"{sentence}.")
        self.example = example
        if example:
            self.add_note(example)


def complaint(where: object, expected: str, found: object, do: str) -> InputError:
    """The error, to be raised, that says what a user has to change.

    where: file, row and key ("cell-4/samples.csv, row 7, column q3_deg"); expected, found and do
    are parts of one sentence, without a full stop.
    """
    return InputError(" ".join(f"{where}: expected {expected}, found {found}; {do}".split()) + ".")


class Stopped(Exception):
    """Work that the user interrupted; the message states what is saved and how to continue."""
