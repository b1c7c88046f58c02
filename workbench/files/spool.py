"""A long sequence with only its first items in memory; the others are in an anonymous temporary file."""

import pickle
import tempfile
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from workbench.core.errors import InputError


class Spool(Sequence):
    """A sequence of items; the first `kept` stay in memory, the others are read from disk on access.

    The file is anonymous: no other process can write to it, and it ends with this process. It is in `folder`, or in
    the default folder for temporary files, which is in memory on many systems.
    """

    def __init__(self, things: Iterable[Any] = (), in_memory: int = 64, folder: Path | None = None):
        self._first: list[Any] = []
        self._places = array(
            "q"
        )  # start of each item in the file: memory grows by 8 bytes per item
        self._file, self._folder = None, folder
        for thing in things:
            self._append(thing, in_memory)

    def _append(self, thing: Any, in_memory: int) -> None:
        if len(self._first) < in_memory:
            self._first.append(thing)
            return
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(prefix="workbench-spool-", dir=self._folder)
            place = self._file.seek(0, 2)
            pickle.dump(thing, self._file, pickle.HIGHEST_PROTOCOL)
            self._file.flush()
        except OSError as error:  # the error on an anonymous file does not name the disk
            raise InputError(
                f"{self._folder or tempfile.gettempdir()}: temporary data cannot be written there "
                f"('{error.strerror}'); free space or choose another folder."
            ) from error
        self._places.append(place)

    def __len__(self) -> int:
        return len(self._first) + len(self._places)

    def __getitem__(self, place):
        if isinstance(place, slice):
            return [self[k] for k in range(*place.indices(len(self)))]
        place = place + len(self) if place < 0 else place
        if not 0 <= place < len(self):
            raise IndexError(place)
        if place < len(self._first):
            return self._first[place]
        return self._read(self._places[place - len(self._first)])

    def __iter__(self) -> Iterator[Any]:
        return (self[k] for k in range(len(self)))

    def _read(self, start: int) -> Any:
        self._file.seek(start)
        return pickle.load(self._file)


class JoinedMapping(Mapping):
    """A long mapping made of many small ones, in the order in which they come; no key is in two of them."""

    def __init__(self, mappings: Sequence[Mapping[str, Any]]):
        self._parts = mappings

    def __len__(self) -> int:
        return sum(len(part) for part in self._parts)

    def __iter__(self) -> Iterator[str]:
        return (key for part in self._parts for key in part)

    def __getitem__(self, key):
        for part in self._parts:
            if key in part:
                return part[key]
        raise KeyError(key)

    def items(self) -> Iterator[tuple[str, Any]]:
        """Keys and values in one go through the parts, not in one for every key."""
        return (item for part in self._parts for item in part.items())


class Made(Sequence):
    """Lazy sequence of `make(item)`; items are computed on every access and not stored."""

    def __init__(self, things: Sequence[Any], make: Callable[[Any], Any]):
        self._things, self._make = things, make

    def __len__(self) -> int:
        return len(self._things)

    def __getitem__(self, place):
        if isinstance(place, slice):
            return [self._make(thing) for thing in self._things[place]]
        return self._make(self._things[place])
