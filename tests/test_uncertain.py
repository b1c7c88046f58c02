"""Values with their standard deviations as text."""

import numpy as np
import pytest

from workbench.core.text.uncertain import with_std


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (0.13, 0.01, "0.130 ± 0.010"),
        (7.83, 11.6, "8 ± 12"),
        (474.3, 68.8, "474 ± 69"),
        (2.3456e-7, 1.2e-8, "2.35e-07 ± 1.2e-08"),
        (0.11, 3e-6, "0.1100000 ± 0.0000030"),
        (0.0, 2e-5, "0.0e+00 ± 2.0e-05"),
        (-0.0001, 0.3, "0.00 ± 0.30"),
        (3.0, 1.2e150, "3 (not determined)"),
        (2e7, 3e7, "20000000 ± 30000000"),
        (0.5, np.inf, "0.5"),
        (0.5, 0.0, "0.5"),
    ],
)
def test_two_digits_of_the_standard_deviation_are_shown(value, std, text):
    assert with_std(value, std) == text
