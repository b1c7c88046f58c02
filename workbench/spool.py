"""A long sequence of which only the first few stand in memory: the rest waits in a nameless file of its own."""

import pickle
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any


class Spool(Sequence):
    """Things in the order in which they came; the first `kept` stay in memory, later ones are read back when asked for.

    The file has no name, so that nobody else can write what is read back, and it goes with the process.
    """

    def __init__(self, things: Iterable[Any] = (), kept: int = 64):
        self._first: list[Any] = []
        self._places: list[tuple[int, int]] = []
        self._file = None
        for thing in things:
            self._append(thing, kept)

    def _append(self, thing, kept):
        if len(self._first) < kept:
            self._first.append(thing)
            return
        if self._file is None:
            self._file = tempfile.TemporaryFile(prefix="workbench-spool-")
        data = pickle.dumps(thing, pickle.HIGHEST_PROTOCOL)
        self._places.append((self._file.seek(0, 2), len(data)))
        self._file.write(data)

    def __len__(self) -> int:
        return len(self._first) + len(self._places)

    def __getitem__(self, place):
        if isinstance(place, slice):
            return [self[k] for k in range(*place.indices(len(self)))]
        place = place + len(self) if place < 0 else place
        if not 0 <= place < len(self):
            raise IndexError(place)
        return self._first[place] if place < len(self._first) else self._read(*self._places[place - len(self._first)])

    def __iter__(self) -> Iterator[Any]:
        return (self[k] for k in range(len(self)))

    def _read(self, start, size):
        self._file.seek(start)
        return pickle.loads(self._file.read(size))


class Made(Sequence):
    """What `make` makes of each of a sequence's things, made anew whenever it is asked for and not kept."""

    def __init__(self, things: Sequence[Any], make: Callable[[Any], Any]):
        self._things, self._make = things, make

    def __len__(self) -> int:
        return len(self._things)

    def __getitem__(self, place):
        if isinstance(place, slice):
            return [self._make(thing) for thing in self._things[place]]
        return self._make(self._things[place])
