"""A value with its standard deviation, as text."""

import math

_SMALLEST = 1e-3
"""Below this, numbers are written with an exponent."""
_UNDETERMINED = 1e6
"""Standard deviation over the value, or over one unit, from which on the value has no meaning."""


def with_std(value: float, std: float) -> str:
    """'0.130 ± 0.010': as many decimals as two digits of the standard deviation have (GUM, JCGM 100:2008, 7.2.6).

    Without a finite standard deviation above 0 the value stands alone, with three digits; with one that no digit of the
    value survives, it is said to be undetermined.
    """
    if not (std > 0 and math.isfinite(std) and math.isfinite(value)):
        return f"{value:.3g}"
    if std > _UNDETERMINED * max(abs(value), 1.0):
        return f"{value:.3g} (not determined)"
    first_digit = math.floor(math.log10(std))
    if max(abs(value), std) < _SMALLEST:
        digits = max(math.floor(math.log10(abs(value) or std)) - first_digit + 1, 1)
        return f"{value:.{digits}e} ± {std:.1e}"
    decimals = max(1 - first_digit, 0)
    return f"{value:z.{decimals}f} ± {std:.{decimals}f}"


__all__ = ["with_std"]
