"""A law that explains nearly all of a large misfit is solved before terms for the rest of its linearisation are added."""

from types import SimpleNamespace

import numpy as np
import pytest

from workbench.diagnosis.search.most_probable_set import dominant_law

GAINS = {(0,): 960.0, (1,): 300.0, (2,): 970.0}


def objective(whole: float):
    """Gains of two laws and, last, a smooth function."""
    is_smooth = np.array([False, False, True])
    return SimpleNamespace(is_smooth=is_smooth, gain=lambda members: GAINS.get(members, whole))


@pytest.mark.parametrize(
    ("whole", "count", "chosen"),
    [
        (1000.0, 20, (0,)),  # 96 % of a misfit of 50 per coordinate
        (1100.0, 20, (0, 1, 2)),  # 87 %
        (1000.0, 500, (0, 1, 2)),  # of a misfit of 2 per coordinate
    ],
)
def test_a_dominant_law_comes_alone(whole, count, chosen):
    assert dominant_law(objective(whole), (0, 1, 2), count) == chosen


def test_a_smooth_function_never_comes_alone():
    assert dominant_law(objective(1000.0), (1, 2), 20) == (1, 2)
