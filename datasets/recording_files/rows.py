"""Rows of a table as lazily created mappings; a session of many images is stored as columns."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Rows(Sequence):
    """Rows `chosen` (m,) of `columns` (n,): float64, or text as numbers (n,) of `texts`, by column; equal to any
    sequence of the same mappings.

    A row holds what its cells hold: nan is an empty one and left out, columns of `integers` give whole numbers.
    """

    columns: Mapping[str, np.ndarray]
    texts: Mapping[str, np.ndarray]
    integers: frozenset[str]
    chosen: np.ndarray

    @classmethod
    def of(cls, columns: Mapping[str, np.ndarray], integers: Sequence[str] = ()) -> "Rows":
        """From columns (n,) of numbers or text."""
        texts, made = {}, {}
        for name, values in columns.items():
            if values.dtype.kind == "f":
                made[name] = values
                continue
            found, place = np.unique(values, return_inverse=True)
            # as bytes a name takes a quarter of the room
            texts[name], made[name] = np.char.encode(found, "utf-8"), place.ravel().astype(np.int32)
        count = len(next(iter(made.values()))) if made else 0
        return cls(made, texts, frozenset(integers), np.arange(count))

    def __len__(self) -> int:
        return len(self.chosen)

    def __getitem__(self, place):
        if isinstance(place, (slice, np.ndarray)):
            return Rows(self.columns, self.texts, self.integers, self.chosen[place])
        row, made = self.chosen[place], {}
        for name, values in self.columns.items():
            if name in self.texts:
                made[name] = self.texts[name][values[row]].decode("utf-8")
            elif values[row] == values[row]:
                made[name] = int(values[row]) if name in self.integers else float(values[row])
        return made

    def __iter__(self) -> Iterator[dict]:
        return (self[k] for k in range(len(self)))

    def __eq__(self, other) -> bool:
        return len(self) == len(other) and all(
            row == other_row for row, other_row in zip(self, other)
        )

    __hash__ = None

    def where(self, column: str, value: str) -> "Rows":
        """Those whose text in that column is `value`."""
        if column not in self.texts:
            return self[np.zeros(len(self), bool)]
        number = np.flatnonzero(self.texts[column] == value.encode("utf-8"))
        return self[np.isin(self.columns[column][self.chosen], number)]

    def by(self, column: str, then: str | None = None) -> "Grouped":
        """Rows of each text in that column, texts in their order here; rows too, or by the numbers of `then`."""
        _, first, group = np.unique(
            self.columns[column][self.chosen], return_index=True, return_inverse=True
        )
        place = first[group.ravel()] if len(self) else np.empty(0, int)  # where its text came first
        order = (
            np.lexsort((self.values(then, 0), place)) if then else np.argsort(place, kind="stable")
        )
        starts = np.flatnonzero(np.diff(place[order], prepend=-1, append=len(self)))
        return Grouped(self[order], column, starts if len(self) else np.zeros(1, int))

    def values(self, column: str, default: float) -> np.ndarray:
        """(m,) numbers of a column, `default` where a row has none."""
        if column not in self.columns:
            return np.full(len(self), float(default))
        found = self.columns[column][self.chosen]
        return np.where(np.isfinite(found), found, default)

    def code(self, column: str, text: str) -> int:
        """The number of a text in that column; KeyError where it is not there."""
        found = np.flatnonzero(self.texts[column] == text.encode("utf-8"))
        if not found.size:
            raise KeyError(text)
        return int(found[0])

    @classmethod
    def kept(cls, rows: Sequence[Mapping], text: Sequence[str]) -> "Rows":
        """From any sequence of such mappings; columns of `text` hold text, "" where a row has none."""
        if isinstance(rows, Rows):
            return rows
        names = list(dict.fromkeys(name for row in rows for name in row))
        columns = {
            name: np.array([str(row.get(name, "")) for row in rows])
            if name in text
            else np.array([row.get(name, np.nan) for row in rows], float)
            for name in names
        }
        cell_lists = [
            name
            for name in names
            if name not in text and all(isinstance(row.get(name, 0), int) for row in rows)
        ]
        return cls.of(columns, cell_lists)


@dataclass(frozen=True, eq=False)
class Grouped(Mapping):
    """Rows of each text of a column; a group is made when it is asked for.

    `rows` one group after the other, of which group k begins at `starts[k]`; starts (g + 1,).
    """

    rows: Rows
    column: str
    starts: np.ndarray

    def __len__(self) -> int:
        return len(self.starts) - 1

    def __iter__(self) -> Iterator[str]:
        return (self.at(k)[0] for k in range(len(self)))

    def __getitem__(self, text: str) -> Rows:
        if not isinstance(text, str):
            raise KeyError(text)
        codes = self.rows.columns[self.column][self.rows.chosen[self.starts[:-1]]]
        found = np.flatnonzero(codes == self.rows.code(self.column, text))
        if not found.size:
            raise KeyError(text)
        return self.at(found[0])[1]

    def items(self) -> Iterator[tuple[str, Rows]]:
        """Texts and rows, in order."""
        return (self.at(k) for k in range(len(self)))

    def at(self, k: int) -> tuple[str, Rows]:
        """Text and rows of group k."""
        rows_of_group = self.rows[self.starts[k] : self.starts[k + 1]]
        return rows_of_group[0][self.column], rows_of_group
