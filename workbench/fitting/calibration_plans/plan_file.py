"""Plans written as TOML, and plans without some of their terms, which `plans` reads."""

from collections.abc import Sequence
from dataclasses import replace

from robot_model.effects import CATALOGUE
from workbench.core.solution import Stage
from workbench.core.terms import switched_off, term_names

NAME = "plan.toml"


def plan_text(stages: Sequence[Stage], comment: str = "") -> str:
    """TOML text that `read_plan` reads back as the same stages; `comment` becomes its first lines."""
    import tomli_w

    lines = "".join(f"# {line}\n" for line in comment.splitlines())
    return lines + tomli_w.dumps({"stage": [_row(stage) for stage in stages]})


def _row(stage: Stage) -> dict:
    """The keys of a stage that differ from their defaults; `earn` always, since it decides what stays."""
    row = {"name": stage.name, "why": stage.why}
    if stage.effects:
        row["effects"] = [
            {"effect": effect, "where": where, **options}
            for effect, where, options in stage.effects
        ]
    usual = Stage("", "")
    for key in ("free", "loss", "canonical", "steps"):
        value = getattr(stage, key)
        if value != getattr(usual, key):
            row[key] = list(value) if key == "free" else value
    row["earn"] = stage.earn
    return row | ({"hold": dict(stage.hold)} if stage.hold else {})


def without_terms(
    stages: Sequence[Stage], patterns: Sequence[str], where: str = "the plan"
) -> tuple[Stage, ...]:
    """The stages without the terms of those names; a stage that loses all its effects is left out.

    patterns: `<where>.<effect>` with shell wildcards. Raises InputError for a pattern that no term matches.
    """
    rows = [row for stage in stages for row in stage.effects]
    names = [term_names(CATALOGUE[effect].effect, place, effect) for effect, place, _ in rows]
    disabled = iter(switched_off(names, patterns, where))
    remaining_stages = []
    for stage in stages:
        effects = tuple(row for row in stage.effects if not next(disabled))
        if effects or not stage.effects:
            remaining_stages.append(replace(stage, effects=effects))
    return tuple(remaining_stages)
