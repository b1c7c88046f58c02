"""Names of reflectors and other groups, which files write and the model knows by numbers."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from datasets.recording import Recording


def with_group_names(
    columns: Mapping[str, np.ndarray], names: Mapping[str, tuple[str, ...]]
) -> dict[str, np.ndarray]:
    """Columns (n,) with the numbers 1, 2, ... of groups that have names replaced by these."""
    named = dict(columns)
    for group, of_group in names.items():
        if group in columns:
            named[group] = np.array(of_group)[np.asarray(columns[group], int) - 1]
    return named


def numbered_as(recording: Recording, names: Mapping[str, tuple[str, ...]]) -> Recording:
    """A recording whose groups have the numbers that `names` gives them by name, as in the recording of a calibration.

    Names that are not among them get the numbers after theirs. Groups with numbers alone stay as they are.
    """
    columns, new_names = dict(recording.columns), dict(recording.group_names)
    for group, known in names.items():
        own_names = recording.group_names.get(group)
        if own_names is None or group not in columns:
            continue
        all_names = list(dict.fromkeys([*known, *own_names]))
        number = np.array([all_names.index(name) + 1 for name in own_names], float)
        columns[group] = number[np.asarray(columns[group], int) - 1]
        new_names[group] = tuple(all_names)
    return replace(recording, columns=columns, group_names=new_names)
