"""Numbers of rows in sentences."""

import numpy as np


def listed_numbers(rows: np.ndarray, max_numbers: int) -> str:
    """Numbers, from 1, of rows (k,) counted from 0: the first `max_numbers`, then how many more there are."""
    numbers = ", ".join(str(row + 1) for row in rows[:max_numbers])
    unlisted = len(rows) - max_numbers
    return f"{numbers} and {unlisted} more" if unlisted > 0 else numbers
