"""Lists of samples: the files that `--fit-samples` and `--test-samples` name."""

from collections.abc import Container
from pathlib import Path

from workbench.core.errors import InputError


def read_list(path: Path | None, known: Container[int], option: str) -> tuple[int, ...] | None:
    """The sample numbers in `path`, one per line; None without a file.

    known: the recording's sample numbers. Raises InputError.
    """
    if path is None:
        return None
    places: dict[int, str] = {}
    for row, line in enumerate(_lines(path, option), start=1):
        if line.strip():
            _add(places, line.strip(), f"{path}, line {row}", known)
    if not places:
        raise InputError(
            f"{path} is empty; {option} expects one sample number per line. Write at least one."
        )
    return tuple(places)


def check_apart(fit: tuple[int, ...] | None, test: tuple[int, ...] | None, path: Path | None):
    """Raise InputError if a sample is in both lists: it would not be held out."""
    shared = sorted(set(fit or ()) & set(test or ()))
    if shared:
        raise InputError(
            f"{path} lists sample {shared[0]} ({len(shared)} in total), which --fit-samples also lists; "
            "a test sample must not be fitted. Remove it from one of the two files."
        )


def _lines(path: Path, option: str) -> list[str]:
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise InputError(
            f"{path} cannot be read as {option}: {error.strerror}; name a text file "
            "with one sample number a line."
        ) from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path} is not UTF-8 text, where {option} expects one sample number a "
            "line; save it as plain text."
        ) from error


def _add(places: dict[int, str], text: str, place: str, known: Container[int]) -> None:
    try:
        number = int(text)
    except ValueError:
        raise InputError(
            f"{place}: expected one whole sample number, found '{text[:40]}'; write "
            "one number a line."
        ) from None
    if number in places:
        raise InputError(
            f"{place}: expected each sample once, found {number} again after "
            f"{places[number]}; remove one of the two."
        )
    if number not in known:
        raise InputError(
            f"{place}: expected the number of a sample of the recording, found "
            f"{number}, which it does not have; correct or remove the line."
        )
    places[number] = place
