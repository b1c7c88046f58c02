"""Terms of a model by name: `<where>.<effect>`, as `joint-3.backlash`, with shell patterns."""

from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase

from workbench.core.errors import InputError


def switched_off(
    terms: Sequence[tuple[str, ...]], patterns: Iterable[str], where: str
) -> list[bool]:
    """Whether each term is switched off by one of the patterns.

    terms: the names of each term, such as ("joint-3.unknown", "joint-3.smooth-function"). where: what to call the
    model in an error sentence. Raises InputError for a pattern that no term matches.
    """
    is_off = [False] * len(terms)
    for pattern in patterns:
        hits = [any(fnmatchcase(name, pattern) for name in names) for names in terms]
        if not any(hits):
            known = ", ".join(dict.fromkeys(names[0] for names in terms))
            known = f"its terms are {known}" if known else "its model has no terms to omit"
            raise InputError(
                f"--without {pattern}: expected a term of {where}, found none of that name; {known}"
            )
        is_off = [hit_of_kind or hit for hit_of_kind, hit in zip(is_off, hits)]
    return is_off


def term_names(effect: str, where: str, name: str) -> tuple[str, ...]:
    """Names of a term: by the vocabulary's word `effect`, or by its `name` in the catalogue."""
    return tuple(dict.fromkeys((f"{where}.{effect}", f"{where}.{name}")))
