"""Reading of TOML, JSON and YAML files: every kind of damaged content becomes one kind of error.

The parsers of the standard library raise several errors that are not their own: RecursionError for
deep nesting, ValueError for integers of thousands of digits, OverflowError where such an integer
becomes a float later. Every reader of this project takes its keys from here.
"""

import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path

LIMITS_MB = {"TOML": 4, "YAML": 4, "JSON": 200}
"""Largest size of a file that is parsed, in MB (10^6 bytes)."""
_DEPTH = 100  # of nested values, and parts of a dotted key
_INT64 = 2**63  # TOML defines integers of 64 bits; larger ones do not fit into a float column
# tomllib takes time in proportion to the square of the number of parts of a key.
_KEY_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+"""
_LONG_KEY = re.compile(rf"(?<![\w-])(?:{_KEY_PART}){{{_DEPTH}}}")


class ContentError(ValueError):
    """File content that is not what its format demands; the message is a part of a sentence."""


def read_toml(path: Path | str) -> dict:
    """The keys of a TOML file. Raises ContentError for its content, OSError for the file."""
    return parse_toml(_text(Path(path), "TOML"))


def read_json(path: Path | str):
    """The value in a JSON file. Raises ContentError for its content, OSError for the file."""
    return parse_json(_text(Path(path), "JSON"))


def read_yaml(path: Path | str, has_documents: bool = False):
    """The value in a YAML file. Raises ContentError for its content, OSError for the file.

    has_documents: the file may hold several documents, whose values become a list.
    """
    import yaml

    def documents(text: str):
        values = [value for value in yaml.safe_load_all(text) if value is not None]
        return values[0] if len(values) == 1 else values

    text = _text(Path(path), "YAML")
    return _parsed(documents if has_documents else yaml.safe_load, text, "YAML", yaml.YAMLError)


def parse_toml(text: str) -> dict:
    """The keys of a TOML text. Raises ContentError."""
    if _LONG_KEY.search(text):
        raise ContentError(f"a dotted key has {_DEPTH} parts or more")
    return _parsed(tomllib.loads, text.replace("\r\n", "\n"), "TOML", tomllib.TOMLDecodeError)


def parse_json(text: str):
    """The value of a JSON text. Raises ContentError."""
    return _parsed(json.loads, text, "JSON", json.JSONDecodeError)


def _text(path: Path, kind: str) -> str:
    try:
        _check_size(path.stat().st_size, kind)
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise ContentError(f"byte {problem.start + 1} is not UTF-8 text") from None
    except ContentError:
        raise
    except ValueError:
        raise ContentError("its name contains a character that no file name can have") from None


def _check_size(size: int, kind: str) -> None:
    limit = LIMITS_MB[kind]
    if size > limit * 1e6:
        raise ContentError(f"{size / 1e6:.0f} MB are more than the {limit} MB of a {kind} file")


def _parsed(parse: Callable, text: str, kind: str, error_type: type[Exception]):
    try:
        value = parse(text)
    except error_type as problem:
        sentence = " ".join(str(problem).split()).rstrip(".")
        raise ContentError(f"no valid {kind}: {sentence[:200]}") from None
    except RecursionError:
        raise ContentError("values are nested too deeply") from None
    except (ValueError, OverflowError, TypeError, AttributeError, LookupError):
        raise ContentError(f"no valid {kind}: a number, date or key cannot be read") from None
    _check_values(value)
    return value


def _check_values(value) -> None:
    """Raise ContentError for values that parse but break whoever uses them.

    These are integers above 64 bits, unpaired surrogates and the null character in text, and
    containers nested more than 100 deep. YAML may refer to a container many times, even to one that
    contains it: each container is looked at once.
    """
    pending = [(value, 0)]
    seen = set()
    while pending:
        item, depth = pending.pop()
        if isinstance(item, str):
            _check_text(item)
        elif isinstance(item, int) and not -_INT64 <= item < _INT64:
            raise ContentError("an integer has more than 64 bits")
        elif isinstance(item, dict | list) and id(item) not in seen:
            if depth > _DEPTH:
                raise ContentError("values are nested too deeply")
            seen.add(id(item))
            if isinstance(item, dict):
                children = [*item.keys(), *item.values()]
            else:
                children = item
            pending.extend((child, depth + 1) for child in children)


def _check_text(text: str) -> None:
    if "\0" in text:
        raise ContentError("a text contains the null character")
    if not text.isascii() and any("\ud800" <= c <= "\udfff" for c in text):
        raise ContentError("a text contains an incomplete character (an unpaired surrogate)")
