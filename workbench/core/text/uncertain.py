"""A value with its standard deviation, as text."""

import math

_SMALLEST = 1e-3
"""Below this, numbers are written with an exponent."""


def with_std(value: float, std: float) -> str:
    """'0.130 ± 0.010': as many decimals as two digits of the standard deviation have (GUM, JCGM 100:2008, 7.2.6).

    Without a finite standard deviation above 0 the value stands alone, with three digits.
    """
    if not (std > 0 and math.isfinite(std) and math.isfinite(value)):
        return f"{value:.3g}"
    first_digit = math.floor(math.log10(std))
    if max(abs(value), std) < _SMALLEST:
        digits = max(math.floor(math.log10(abs(value) or std)) - first_digit + 1, 1)
        return f"{value:.{digits}e} ± {std:.1e}"
    decimals = max(1 - first_digit, 0)
    return f"{value:z.{decimals}f} ± {std:.{decimals}f}"


__all__ = ["with_std"]
