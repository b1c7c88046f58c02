"""Alarms on values that no machine has, although they fit: the law then stands for something else."""

from collections.abc import Mapping, Sequence

from workbench.diagnosis.levels import CRITICAL_T
from workbench.diagnosis.robot.derived import DEFLECTION
from workbench.explanation.words import length, measured

_FAR = 10.0
"""Standard deviations of its prior beyond which a value is not plausible: they are orders of magnitude."""


def implausible_values(rows: Sequence[Mapping], size: float | None) -> tuple[str, ...]:
    """One sentence for each value that is significantly different from 0 and not plausible, without a full stop.

    rows: of a term's parameters, as `Bench.parameters` has them. size: RMS displacement by the term, mm. A deflection
    that is not significant while it moves the points by `size` has no direction that the data determine.
    """
    found = []
    for row in rows:
        value, std, prior = row["value"], row["std"], row.get("prior")
        value_text = measured(value, std, row["unit"])
        if prior and abs(value) > max(_FAR * prior, CRITICAL_T * std):
            expected = measured(prior, None, row["unit"])
            found.append(
                f"{row['label']} is {value_text}, which is not plausible (expected before measuring: 0 ± {expected}): "
                "another cause may stand behind it"
            )
        elif row["name"] == DEFLECTION and size and value < CRITICAL_T * std:
            found.append(
                f"the deflection of {value_text} is not significant in these poses, although the term makes "
                f"{length(size)}: other causes explain the poses as well"
            )
    return tuple(found)


__all__ = ["implausible_values"]
