"""Standard deviations of effects next to a geometry of which the data leave a gauge freedom."""

import numpy as np

from robot_model.effects import CATALOGUE
from test_diagnosis_engine import recorded
from workbench.diagnosis.robot.bench import bench_of

TWIST = np.array([0.2, -0.1, 0.05, -5e-5, 7e-5, 1.1e-4])


def test_a_warm_up_of_the_base_is_as_certain_as_the_data_make_it():
    """Base and joints may turn together by any angle: a freedom of the model, in which the drift is not less certain.

    The reference is the spread of the drift over recordings with other noise.
    """
    effect = CATALOGUE["base-warm-up"]("base", time_constant=100.0)
    made = []
    for seed in range(12):
        rows = bench_of(recorded(40 + seed, (effect,), TWIST)).parameters((effect,))
        made.append([(row["value"], row["std"]) for row in rows])
    value, std = np.moveaxis(np.array(made), 2, 0)
    z = (value - TWIST) / std
    assert 0.5 < (z**2).mean() < 1.6
    # significant, as it is
    assert (np.abs(value[:, 0]) > 3 * std[:, 0]).all()
