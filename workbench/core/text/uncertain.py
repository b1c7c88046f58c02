"""A value with its standard deviation, as text."""

import math

_MOST_DECIMALS = 6


def with_std(value: float, std: float) -> str:
    """'0.130 ± 0.010': as many decimals as two digits of the standard deviation have (GUM, JCGM 100:2008, 7.2.6).

    Without a finite standard deviation above 0 the value stands alone, with three digits.
    """
    if not (std > 0 and math.isfinite(std) and math.isfinite(value)):
        return f"{value:.3g}"
    decimals = max(1 - math.floor(math.log10(std)), 0)
    if decimals > _MOST_DECIMALS:
        return f"{value:.3g} ± {std:.2g}"
    return f"{value:z.{decimals}f} ± {std:.{decimals}f}"


__all__ = ["with_std"]
