"""File names from identifiers that a user chose: one name per identifier, safe on every file system, reversible.

Percent-encoding of the UTF-8 bytes (RFC 3986, section 2.1) of everything but ASCII letters, digits, `_`, `-` and inner
dots. Windows and macOS do not distinguish capitals, so that `Left` and `left` would share a file there; capitals are
encoded where two identifiers differ in nothing else. Windows reserves device names such as `con` and `com1`, whatever
their extension. A name beyond `LONGEST` characters is cut and ends in a part of its SHA-256: still unique, but only the
answer of the command that wrote it says which identifier it stands for.
"""

import hashlib
import re
from collections import Counter
from collections.abc import Iterable

LONGEST = 150
"""Characters of a name without its extension: with a folder before it, it stays below the 255 bytes of a file name."""

_PLAIN = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-.")
_DEVICE = re.compile(r"(?:con|prn|aux|nul|com\d|lpt\d)(?:\..*)?", re.IGNORECASE)
_EMPTY = "%"
_DIGITS = 16


def file_name(identifier: str, encode_capitals: bool = False) -> str:
    """The file name, without extension, of an identifier.

    encode_capitals: True for the identifiers that `differ_in_case_only` returns.
    """
    if not identifier:
        return _EMPTY
    encoded = [_encode(character, encode_capitals) for character in identifier]
    _escape_ends(encoded, identifier)
    name = "".join(encoded)
    if len(name) <= LONGEST:
        return name
    return _shorten(name, identifier)


def _escape_ends(encoded: list[str], identifier: str) -> None:
    """Escape a first or last character that is special at its place.

    A leading dot hides a file, a leading hyphen looks like an option, and Windows drops a trailing dot.
    """
    first, last = identifier[0], identifier[-1]
    if first in ".-" or _DEVICE.fullmatch(identifier):
        encoded[0] = _escape(first)
    if last == ".":
        encoded[-1] = _escape(last)


def differ_in_case_only(identifiers: Iterable[str]) -> frozenset[str]:
    """Those of the identifiers whose name another one would overwrite where a file system ignores case."""
    distinct = set(identifiers)
    count = Counter(identifier.casefold() for identifier in distinct)
    return frozenset(identifier for identifier in distinct if count[identifier.casefold()] > 1)


def _encode(character: str, encode_capitals: bool) -> str:
    is_capital = "A" <= character <= "Z"
    if character in _PLAIN and not (encode_capitals and is_capital):
        return character
    return _escape(character)


def _escape(character: str) -> str:
    return "".join(f"%{byte:02X}" for byte in character.encode("utf-8", "surrogatepass"))


def _shorten(name: str, identifier: str) -> str:
    digest = hashlib.sha256(identifier.encode("utf-8", "surrogatepass")).hexdigest()[:_DIGITS]
    shortened = name[: LONGEST - _DIGITS - 1]
    shortened = re.sub(r"%[0-9A-F]?$", "", shortened)  # no half of an escape
    return f"{shortened}~{digest}"
