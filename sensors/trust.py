"""Statements of a calibration on its own reliability, as files of cameras and scanners carry them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from workbench.core.errors import InputError

_KINDS = ("shift", "tilt")


@dataclass(frozen=True)
class Trust:
    """Verdict of a calibration: whether it is `usable`, its `warnings`, and `stripe_px`: 1 sigma (px) by which whole
    stripes are shifted, and tilted at their ends, beyond noise where that is significant."""

    usable: bool = True
    warnings: tuple[str, ...] = ()
    stripe_px: tuple[float, float] = (0.0, 0.0)

    def as_keys(self) -> dict:
        """The table `[verdict]` of a file."""
        stripes = {f"stripe_{name}_px": float(v) for name, v in zip(_KINDS, self.stripe_px)}
        return {"usable": bool(self.usable), "warnings": list(self.warnings), **stripes}


def trust_from_keys(keys: Mapping, called: str) -> Trust | None:
    """The verdict that `keys` of a file hold; None for files of older versions. InputError where it is none."""
    table = keys.get("verdict")
    if table is None:
        return None
    stripes = _stripes(table)
    warnings = table.get("warnings", []) if isinstance(table, Mapping) else None
    is_listed = isinstance(warnings, list) and all(isinstance(warning, str) for warning in warnings)
    if stripes is None or not is_listed or not isinstance(table.get("usable"), bool):
        raise InputError(
            f"{called}, [verdict]: expected usable = true or false, a list of warnings and lengths in px from 0, found "
            "others; calibrate again"
        )
    return Trust(table["usable"], tuple(warnings), stripes)


def _stripes(table) -> tuple[float, float] | None:
    """(shift, tilt) px of a table, None where they are no such lengths."""
    if not isinstance(table, Mapping):
        return None
    try:
        shift, tilt = (float(table.get(f"stripe_{name}_px", 0.0)) for name in _KINDS)
    except (TypeError, ValueError):
        return None
    return (shift, tilt) if np.isfinite([shift, tilt]).all() and min(shift, tilt) >= 0 else None
