"""Which rows a plausibility check looks at."""

import numpy as np


def even_rows(recording, most: int) -> np.ndarray:
    """At most about `most` row numbers in ascending order, evenly among the rows of every ball or reflector."""
    label = (
        recording.ball
        if recording.measures in ("ball-centre", "ball-surface")
        else recording.reflector
    )
    first = np.unique(label, return_index=True)[1]
    order = np.argsort(label, kind="stable")
    even = np.linspace(0, recording.n - 1, min(most, recording.n)).astype(int)
    return np.unique(np.concatenate([order[even], first]))
