"""Parameters of a model: named values with unit, null value, typical size, prior and free mask."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property

import numpy as np

from workbench.core.errors import InputError


@dataclass(frozen=True)
class Parameter:
    """One number of a model.

    `key` is `<where>.<name>` with `where` from the vocabulary (`joint-3`, `base`, `tool`, ...).
    `null` is the value at which the parameter does nothing or is nominal. `typical` is the size,
    in `unit`, that is expected before the measurement; it scales the columns of the Jacobian and
    makes millimetres and radians comparable. `label` is how a sentence calls it. `prior` is
    the 1 sigma, in `unit`, of its prior about `null`; None: no prior.
    """

    key: str
    unit: str
    null: float = 0.0
    typical: float = 1.0
    label: str = ""
    prior: float | None = None


def _check_keys(keys: Sequence[str]) -> None:
    if len(set(keys)) != len(keys):
        duplicates = sorted({key for key in keys if keys.count(key) > 1})
        raise InputError(
            f"two parameters are called {duplicates[0]}: list an effect at one place once"
        )


@dataclass(frozen=True)
class Parameters:
    """Ordered, frozen table of P parameters. Methods return a changed copy.

    Attributes:
        table: Key, unit, null value, typical size and prior of each parameter.
        values: (P,) each in the unit of its parameter (mm, rad, ...).
        mask: (P,) True where free, that is, estimated by a solve.

    Examples:
        >>> from workbench.core.parameters import Parameter
        >>> table = [Parameter("joint-1.d", "mm", null=290.0), Parameter("joint-1.theta", "rad")]
        >>> parameters = wb.Parameters.of(table).free("*.theta").update({"joint-1.theta": 0.01})
        >>> parameters["joint-1.d"], parameters.pack().tolist()
        (290.0, [0.01])
    """

    table: tuple[Parameter, ...]
    values: np.ndarray
    mask: np.ndarray

    @classmethod
    def of(cls, table: Iterable[Parameter]) -> "Parameters":
        """All of `table` at their nulls, none free."""
        table = tuple(table)
        _check_keys([parameter.key for parameter in table])
        values = np.array([parameter.null for parameter in table], dtype=float)
        return cls(table, values, np.zeros(len(table), bool))

    @cached_property
    def index(self) -> Mapping[str, int]:
        """Place of each key."""
        return {parameter.key: k for k, parameter in enumerate(self.table)}

    @property
    def keys(self) -> tuple[str, ...]:
        """(P,) keys in order, `<where>.<name>`."""
        return tuple(self.index)

    @cached_property
    def typical(self) -> np.ndarray:
        """(P,) typical sizes, each in its parameter's unit."""
        return np.array([parameter.typical for parameter in self.table])

    @cached_property
    def nulls(self) -> np.ndarray:
        """(P,) nulls, each in its parameter's unit."""
        return np.array([parameter.null for parameter in self.table])

    @cached_property
    def precision(self) -> np.ndarray:
        """(P,) 1 / prior^2, 0 where there is no prior."""
        return np.array([0.0 if p.prior is None else p.prior**-2 for p in self.table])

    def __len__(self) -> int:
        return len(self.table)

    def __getitem__(self, key: str) -> float:
        return float(self.values[self.index[key]])

    def matching(self, *patterns: str) -> np.ndarray:
        """(P,) True where a key matches one of the shell patterns; each must match something."""
        chosen = np.zeros(len(self), bool)
        for pattern in patterns:
            hits = np.array([fnmatchcase(key, pattern) for key in self.keys], bool)
            if not hits.any():
                raise self._no_match(pattern)
            chosen |= hits
        return chosen

    def _no_match(self, pattern: str) -> InputError:
        first = ", ".join(self.keys[:6]) + (", ..." if len(self.keys) > 6 else "")
        return InputError(f"no parameter matches '{pattern}': the model has {first}")

    def free(self, *patterns: str) -> "Parameters":
        """The same with the matching ones free."""
        mask = self.mask | self.matching(*patterns)
        return replace(self, mask=mask)

    def fix(self, *patterns: str) -> "Parameters":
        """The same with the matching ones fixed at their present value."""
        mask = self.mask & ~self.matching(*patterns)
        return replace(self, mask=mask)

    def only(self, mask: np.ndarray) -> "Parameters":
        """The same with exactly the True ones of `mask` (P,) free."""
        return replace(self, mask=np.asarray(mask, bool))

    def pack(self) -> np.ndarray:
        """Values of the free ones, in order."""
        return self.values[self.mask]

    def unpack(self, free_values: np.ndarray) -> "Parameters":
        """The same with the free ones set to `free_values`."""
        values = self.values.copy()
        values[self.mask] = free_values
        return replace(self, values=values)

    def update(self, values: Mapping[str, float]) -> "Parameters":
        """The same with some values set by key; KeyError where the model has no such key."""
        new = self.values.copy()
        for key, value in values.items():
            new[self.index[key]] = value
        return replace(self, values=new)

    def nudged(self) -> "Parameters":
        """Effects at their null value, changed by a third of their typical size.

        Parameters that multiply an effect (a mass that acts only through a compliance) have a derivative only then.
        """
        effect = np.array([key.count(".") > 1 for key in self.keys], bool)
        is_null = self.mask & effect & (self.values == self.nulls)
        values = np.where(is_null, self.nulls + self.typical / 3, self.values)
        return replace(self, values=values)

    def take_over(self, other: "Parameters") -> "Parameters":
        """Values and mask of `other` for the keys that both have."""
        values = self.values.copy()
        mask = self.mask.copy()
        for k, key in enumerate(self.keys):
            if key in other.index:
                values[k] = other.values[other.index[key]]
                mask[k] = other.mask[other.index[key]]
        return replace(self, values=values, mask=mask)

    def to_toml(self) -> str:
        """One table line a parameter: key, value, unit, free."""
        rows = zip(self.table, self.values.tolist(), self.mask.tolist())
        return "[parameters]\n" + "".join(
            f'"{p.key}" = {{ value = {value!r}, unit = "{p.unit}", free = {str(free).lower()} }}\n'
            for p, value, free in rows
        )
