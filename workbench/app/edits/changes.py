"""One change of an edit session, its checks, and its line in session.toml."""

from collections.abc import Mapping
from dataclasses import dataclass

from workbench.core.errors import InputError

SAMPLES = "samples"
POSES = "poses"
IMAGES = "images"
STAGES = "stages"
EFFECTS = "effects"
KINDS = (SAMPLES, POSES, IMAGES, STAGES, EFFECTS)
EXCLUDE = "exclude"
INCLUDE = "include"
ADD = "add"
ACTIONS = (EXCLUDE, INCLUDE, ADD)
ADDED = "added effects"
"""Name of the stage that holds the effects that changes add."""
_KEYS = ("action", "kind", "items", "why")


@dataclass(frozen=True)
class Change:
    """One edit: `action` on `items` of one `kind`.

    "exclude" leaves items out, "include" takes excluded items back, "add" adds effects to the plan.
    Items are sample numbers of samples; of poses the numbers of samples that were measured there (all
    samples of these poses are meant); paths as in images.csv of images; names of stages; labels such as
    "backlash at joint-3" of effects (`effect_label`), or, where effects are added, tables with the keys
    effect, where and the options of the effect. `why` is free text for people.
    """

    action: str
    kind: str
    items: tuple
    why: str = ""

    def __hash__(self) -> int:
        """Of what can be hashed: the items of added effects are tables, which cannot."""
        return hash((self.action, self.kind, len(self.items), self.why))


def effect_label(row: Mapping) -> str:
    """Name of an effect with its place and options: "transmission-harmonic at joint-3 (order=2)"."""
    options = sorted(_options_of(row).items())
    tail = ", ".join(f"{key}={_plain(value)}" for key, value in options)
    return f"{row['effect']} at {row['where']}" + (f" ({tail})" if tail else "")


def _options_of(row: Mapping) -> dict:
    """Keys of an effect that are options of its class."""
    return {key: value for key, value in row.items() if key not in ("effect", "where")}


def _plain(value: object) -> object:
    """An option for people: a float without the digits that rounding leaves, such as 3104.3500000000004."""
    return f"{value:.10g}" if isinstance(value, float) else value


def read_change(row: object, where: str) -> Change:
    """The change that a table of session.toml holds. where: names the place in messages. Raises InputError."""
    if not isinstance(row, Mapping):
        raise InputError(
            f"{where}: expected a table with action, kind and items, found {row!r}; correct it"
        )
    for key in row:
        if key not in _KEYS:
            raise InputError(
                f"{where}: expected the keys {', '.join(_KEYS)}, found '{key}'; remove or rename it"
            )
    action = row.get("action")
    kind = row.get("kind")
    _check_choice(action, ACTIONS, f"{where}, key action")
    _check_choice(kind, KINDS, f"{where}, key kind")
    if action == ADD and kind != EFFECTS:
        raise InputError(
            f"{where}, key kind: expected effects where action is add, found '{kind}'; correct it"
        )
    items = row.get("items")
    why = row.get("why", "")
    if not isinstance(items, list) or not items:
        raise InputError(
            f"{where}, key items: expected a list with at least one entry, found {items!r}; correct it"
        )
    if not isinstance(why, str):
        raise InputError(
            f"{where}, key why: expected text, found {why!r}; put it in quotation marks"
        )
    return Change(action, kind, tuple(_item(item, action, kind, where) for item in items), why)


def _check_choice(value, choices, where: str) -> None:
    if value not in choices:
        raise InputError(
            f"{where}: expected one of {', '.join(choices)}, found {value!r}; correct it"
        )


def _item(item, action: str, kind: str, where: str):
    if kind in (SAMPLES, POSES):
        if type(item) is not int:
            raise InputError(
                f"{where}, key items: expected sample numbers, found {item!r}; write whole numbers"
            )
        return item
    if action == ADD:
        return _added_effect(item, where)
    if not isinstance(item, str):
        raise InputError(
            f"{where}, key items: expected text, found {item!r}; put it in quotation marks"
        )
    return item


def _added_effect(item, where: str) -> dict:
    from robot_model.effects import CATALOGUE
    from workbench.core.effect import make_effects

    if not isinstance(item, Mapping) or not {"effect", "where"} <= set(item):
        raise InputError(
            f"{where}, key items: expected tables with effect and where, found {item!r}; correct it"
        )
    try:
        make_effects(CATALOGUE, [(item["effect"], item["where"], _options_of(item))])
    except InputError as problem:
        raise InputError(f"{where}, key items: {problem}") from None
    return dict(item)


def change_line(change: Change) -> str:
    """The change as one inline table of TOML."""
    keys = {"action": change.action, "kind": change.kind, "items": list(change.items)}
    if change.why:
        keys["why"] = change.why
    return _inline(keys)


def _inline(value) -> str:
    """A value of session.toml on one line."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_inline(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, list | tuple):
        if all(type(inner) is int for inner in value):  # a brush selects up to a million samples
            return f"{list(value)}"
        return "[" + ", ".join(_inline(inner) for inner in value) + "]"
    import tomli_w

    return tomli_w.dumps({"k": value}).removeprefix("k = ").rstrip("\n")
