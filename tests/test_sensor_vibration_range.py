"""The frequencies at which a vibration of the mirror is searched for."""

from types import SimpleNamespace

import numpy as np
import pytest

from sensors.effects.recorded import MirrorVibration


def frequencies(pause_s):
    """Grid (rad/s) of ten sweeps of 13 images, 0.3 s apart, with a pause after each."""
    sweep = 0.3 * np.arange(13)
    times = (sweep + (pause_s + sweep[-1]) * np.arange(10)[:, None]).ravel()
    chain = SimpleNamespace(times=times, places=lambda where: (where,))
    (grid,) = MirrorVibration.grids(chain)
    return np.asarray(grid.values), float(np.ptp(times))


@pytest.mark.parametrize("pause_s", [1.0, 30.0, 70.0, 110.0])
def test_pauses_do_not_lower_the_highest_frequency(pause_s):
    """Half the rate of the images within a sweep, however long the recording: 0.83 Hz was out of reach in 12 minutes."""
    values, duration = frequencies(pause_s)
    assert values[-1] > 0.99 * np.pi / 0.3
    assert (
        np.diff(values).max() * duration < 2 * np.pi / 2.9
    )  # a period in the recording has three of them
    assert len(values) <= 6000
