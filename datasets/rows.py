"""Rows of a table as mappings that are made when one is asked for: a session of many pictures stands as columns."""

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
        return len(self) == len(other) and all(mine == its for mine, its in zip(self, other))

    __hash__ = None

    def where(self, column: str, value: str) -> "Rows":
        """Those whose text in that column is `value`."""
        if column not in self.texts:
            return self[np.zeros(len(self), bool)]
        number = np.flatnonzero(self.texts[column] == value.encode("utf-8"))
        return self[np.isin(self.columns[column][self.chosen], number)]

    def by(self, column: str) -> dict[str, "Rows"]:
        """Rows of each text in that column, texts and rows in their order here."""
        codes = self.columns[column][self.chosen]
        order = np.argsort(codes, kind="stable")
        parts = np.split(order, np.flatnonzero(np.diff(codes[order])) + 1) if len(order) else []
        names = {part[0]: self.texts[column][codes[part[0]]].decode("utf-8") for part in parts}
        return {names[part[0]]: self[part] for part in sorted(parts, key=lambda part: part[0])}

    def values(self, column: str, otherwise: float) -> np.ndarray:
        """(m,) numbers of a column, `otherwise` where a row has none."""
        if column not in self.columns:
            return np.full(len(self), float(otherwise))
        found = self.columns[column][self.chosen]
        return np.where(np.isfinite(found), found, otherwise)

    @classmethod
    def kept(cls, rows: Sequence[Mapping], text: Sequence[str]) -> "Rows":
        """From any sequence of such mappings; columns of `text` hold text, "" where a row has none."""
        if isinstance(rows, Rows):
            return rows
        names = list(dict.fromkeys(name for row in rows for name in row))
        columns = {name: np.array([str(row.get(name, "")) for row in rows]) if name in text else
                   np.array([row.get(name, np.nan) for row in rows], float) for name in names}  # fmt: skip
        whole = [name for name in names if name not in text and all(isinstance(row.get(name, 0), int) for row in rows)]
        return cls.of(columns, whole)
