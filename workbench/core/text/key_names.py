"""Suggestions for misspelt or renamed keys."""

import difflib
from collections.abc import Iterable

UNITS = ("_mm", "_deg", "_kg")
"""Endings that say the unit of a key."""

_SYNONYMS = {
    "center": "com",
    "center_of_gravity": "com",
    "center_of_mass": "com",
    "centre": "com",
    "centre_of_gravity": "com",
    "centre_of_mass": "com",
    "centroid": "com",
    "cog": "com",
    "cg": "com",
    "weight": "mass",
    "joint_type": "kind",
    "type": "kind",
    "gear": "gear_ratio",
    "reduction": "gear_ratio",
    "transmission_ratio": "gear_ratio",
    "range": "limits",
    "direction": "sign",
    "coupling": "coupled",
}
"""Other words of the field, without their unit, and the key that stands for them."""


def closest_key(name: str, known: Iterable[str], similarity: float = 0.75) -> str | None:
    """The known key that `name` was probably meant to be, or None.

    In this order: a key with the same first word, where one of the two states a unit (`mass` for `mass_kg`); a synonym
    of the field (`centre_mm` for `com_mm`); the key with the most similar spelling, from `similarity` (0 to 1) on.
    """
    known = list(known)
    if name.endswith(UNITS):
        with_unit = known
    else:
        with_unit = [key for key in known if key.endswith(UNITS)]
    word = name.split("_")[0]
    same_word = [key for key in with_unit if key.split("_")[0] == word]
    if same_word:
        return _with_unit_of(name, same_word)
    synonyms = [key for key in known if _concept(key) == _concept(name)]
    if synonyms:
        return _with_unit_of(name, synonyms)
    similar = difflib.get_close_matches(name, known, 1, similarity)
    return similar[0] if similar else None


def _concept(name: str) -> str:
    """Return the quantity that a key names, without its unit and alternative words."""
    name = name.lower()
    for unit in UNITS:
        name = name.removesuffix(unit)
    return _SYNONYMS.get(name, name)


def _with_unit_of(name: str, keys: list[str]) -> str:
    """The key with the same unit as `name`, else the first."""
    unit = next((unit for unit in UNITS if name.endswith(unit)), "")
    return next((key for key in keys if unit and key.endswith(unit)), keys[0])
