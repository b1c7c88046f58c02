"""Rules for every row of samples.csv: one function each, run in the order of RULES.

A rule takes the table and the `Context` and raises InputError for the first row that breaks it.
Rules about plausible sizes (radians, metres, limits) are in `datasets.samples.plausible`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from datasets.errors import complaint
from datasets.formats.table import Table
from datasets.samples.columns import (
    AXES,
    FIXED_TO,
    FLANGE,
    INTEGERS,
    KINDS,
    LENGTHS,
    POINT,
    QUATERNION,
    Kind,
    intended_column,
    joint_columns,
    joint_number,
)
from workbench.core.vocabulary import Covariate


@dataclass(frozen=True)
class Context:
    """Further properties of a recording that the checks of its samples use."""

    measures: str
    robot: Mapping = field(default_factory=dict)
    balls: Mapping[int, tuple] = field(default_factory=dict)
    sigma_mm: float | None = None
    small_range: bool = False
    trust_data: bool = False
    """Accept with a warning what `datasets.samples.plausible` would refuse."""

    @property
    def kind(self) -> Kind:
        return KINDS[self.measures]


def first(broken: np.ndarray) -> int | None:
    """Index of the first True, or None."""
    return int(np.argmax(broken)) if broken.any() else None


def has_columns(table: Table, context: Context) -> None:
    """The columns that the kind of recording needs are there."""
    for name in ("sample", *context.kind.columns):
        _has(table, name, context)
    groups = context.kind.either
    if groups and not any(set(group) <= set(table.columns) for group in groups):
        named = " or ".join(" ".join(group) for group in groups)
        raise complaint(
            f"{table.called}, row 1",
            f"columns {named}",
            "neither complete",
            f"add them: a sample of {context.measures} is {context.kind.sample}",
        )


def _has(table: Table, name: str, context: Context) -> None:
    if name in table.columns:
        return
    similar_name = next((c for c in table.columns if intended_column(c) == name), None)
    do = (
        f"convert {similar_name} and rename it to {name}"
        if similar_name
        else f"add it: a sample of {context.measures} is {context.kind.sample}"
    )
    found = f"the column {similar_name}" if similar_name else "no such column"
    raise complaint(f"{table.called}, column {name}", "this column", found, do)


def joints_are_named(table: Table, context: Context) -> None:
    """Joint columns run from 1 without a gap and carry their unit."""
    names = joint_columns(table.columns)
    for name in table.columns:
        if (similar_name := intended_column(name)) and similar_name.startswith("q"):
            raise complaint(
                f"{table.called}, column {name}",
                f"a joint reading called {similar_name}",
                name,
                f"convert it to degrees and rename it to {similar_name}",
            )
    if context.kind.joints and not names and not set(FLANGE) & set(table.columns):
        raise complaint(
            f"{table.called}, column q1_deg",
            "joint readings q1_deg … qN_deg, or flange poses",
            "none",
            "add them",
        )
    numbers = [joint_number(name) for name in names]
    if numbers != list(range(1, len(numbers) + 1)):
        missing = next((k for k, n in enumerate(numbers, 1) if n != k), len(numbers))
        raise complaint(
            f"{table.called}, column q{missing}_deg",
            "joints numbered 1, 2, … once each",
            ", ".join(names),
            "add the missing joint or rename the columns",
        )


def flange_is_whole(table: Table, context: Context) -> None:
    """All seven columns of a flange pose are there, or none, and its place is in mm.

    No flange stays within 10 mm of the base of its arm: such numbers are metres.
    """
    similar_names = [
        name
        for name in table.columns
        if name in FLANGE or (intended_column(name) or "").startswith("flange")
    ]
    missing = [name for name in FLANGE if name not in table.columns]
    if similar_names and missing:
        other = next((name for name in similar_names if intended_column(name) == missing[0]), None)
        do = (
            f"convert {other} and rename it to {missing[0]}"
            if other
            else f"add it next to {similar_names[0]}"
        )
        raise complaint(
            f"{table.called}, column {missing[0]}",
            "flange poses " + " ".join(FLANGE),
            f"the column {other}" if other else "no such column",
            do,
        )
    if similar_names and not context.small_range:
        largest = np.abs([table.columns[name] for name in FLANGE[:3]]).max()
        if largest < 10:
            raise complaint(
                f"{table.called}, columns flange_x_mm, flange_y_mm, flange_z_mm",
                "places in mm",
                f"a flange within {largest:.3g} of the base, as if in metres",
                "multiply them by 1000",
            )


def joints_match_robot(table: Table, context: Context) -> None:
    """As many joint readings as the robot has joints, each in the unit of its kind."""
    rows = context.robot.get("joint", context.robot.get("joints"))
    names = joint_columns(table.columns)
    if rows is None or not names:
        return
    if len(names) != len(rows):
        raise complaint(
            f"{table.called}, column {names[-1]}",
            f"{len(rows)} joints as in the robot file",
            f"{len(names)} joint columns",
            "use the robot file of this arm or add the columns",
        )
    for name, joint in zip(names, rows):
        if not isinstance(joint, str):
            unit = "mm" if joint.get("kind") == "prismatic" else "deg"
            if not name.endswith(unit):
                raise complaint(
                    f"{table.called}, column {name}",
                    f"{unit} for this kind of joint",
                    name,
                    f"rename it or correct kind of joint {joint_number(name)} in the robot file",
                )


def numbers_are_finite(table: Table, context: Context) -> None:
    """No nan, no infinity, and nothing too large to be a measurement."""
    for name, values in table.columns.items():
        if values.dtype.kind != "f":
            continue
        row = first(~(np.abs(values) < 1e12))
        if row is not None:
            raise complaint(
                table.where(row, name),
                "a finite number",
                str(values[row]),
                "correct the cell or delete the row",
            )


def integers_are_whole(table: Table, context: Context) -> None:
    """Numbers of samples, balls, poses, reflectors … are whole numbers."""
    for name in INTEGERS:
        if name in table.columns:
            row = first(table.columns[name] != np.round(table.columns[name]))
            if row is not None:
                raise complaint(
                    table.where(row, name),
                    "a whole number",
                    f"{table.columns[name][row]:g}",
                    "number them 1, 2, 3 …",
                )


def samples_are_unique(table: Table, context: Context) -> None:
    """Every sample number occurs once."""
    values, seen = table.columns["sample"], {}
    for row, value in enumerate(values):
        if value in seen:
            raise complaint(
                table.where(row, "sample"),
                "every sample number once",
                f"{value:.0f} again (first in row {table.rows[seen[value]]})",
                "delete the copy or give it another number",
            )
        seen[value] = row


def lengths_are_positive(table: Table, context: Context) -> None:
    """Standard deviations (sigma_mm, sigma_deg) and length_mm are above zero in every row."""
    for name in LENGTHS:
        if name in table.columns:
            row = first(table.columns[name] <= 0)
            if row is not None:
                raise complaint(
                    table.where(row, name),
                    "a number above 0",
                    f"{table.columns[name][row]:g}",
                    "correct it, or delete the column if it is unknown",
                )


def physical_bounds(table: Table, context: Context | None = None) -> None:
    """No load is negative, and nothing is colder than absolute zero."""
    for name, values in table.columns.items():
        is_load, is_temperature = (
            name == "payload_kg",
            Covariate.of(name).kind == "temperature",
        )
        if not (is_load or is_temperature) or values.dtype.kind != "f":
            continue
        minimum, expected = (
            (0.0, "a mass of 0 kg or more")
            if is_load
            else (-273.15, "a temperature above -273.15 °C")
        )
        row = first(values < minimum)
        if row is not None:
            raise complaint(table.where(row, name), expected, f"{values[row]:g}", "correct it")


def approach_is_a_sign(table: Table, context: Context) -> None:
    """approach1 … approachN is -1, 0 or 1."""
    for name in table.columns:
        if Covariate.of(name).kind == "approach":
            row = first(~np.isin(table.columns[name], (-1, 0, 1)))
            if row is not None:
                raise complaint(
                    table.where(row, name),
                    "-1, 0 or 1",
                    str(table.columns[name][row]),
                    "write only the sign of the last motion",
                )


def fixed_to_is_known(table: Table, context: Context) -> None:
    """fixed_to is tool, base or floor."""
    if "fixed_to" in table.columns:
        row = first(~np.isin(table.columns["fixed_to"], FIXED_TO))
        if row is not None:
            raise complaint(
                table.where(row, "fixed_to"),
                "tool, base or floor",
                repr(str(table.columns["fixed_to"][row]))[:40],
                "write one of these three",
            )


def directions_are_unit(table: Table, context: Context) -> None:
    """Quaternions and axes have length one, within what rounding to three digits leaves."""
    for group in (QUATERNION, FLANGE[3:], *AXES):
        if set(group) <= set(table.columns):
            norm = np.linalg.norm([table.columns[name] for name in group], axis=0)
            row = first(np.abs(norm - 1) > 2e-3)
            if row is not None:
                raise complaint(
                    table.where(row, " ".join(group)),
                    "length 1",
                    f"length {norm[row]:.4g}",
                    "divide by the length, or check the order of the columns",
                )


def balls_are_known(table: Table, context: Context) -> None:
    """Every measured ball stands in artefact.csv."""
    if "ball" in table.columns and context.balls:
        row = first(~np.isin(table.columns["ball"], list(context.balls)))
        if row is not None:
            known = ", ".join(map(str, sorted(context.balls)))
            raise complaint(
                table.where(row, "ball"),
                f"a ball of artefact.csv ({known})",
                f"{table.columns['ball'][row]:.0f}",
                "correct the number or add the ball to artefact.csv",
            )


def groups_constrain(table: Table, context: Context) -> None:
    """Points that are touched, and pairs, have the rows that make them say something."""
    for name, min_rows in (("point", 2), ("pair", 2)):
        if name in context.kind.columns:
            _, index, count = np.unique(
                table.columns[name], return_inverse=True, return_counts=True
            )
            wrong = (
                count[index] != 2
                if name == "pair"
                else np.full(len(index), bool(np.all(count < min_rows)))
            )
            row = first(wrong)
            if row is not None:
                or_more = " or more" if name == "point" else ""
                raise complaint(
                    table.where(row, name),
                    f"two rows{or_more} with one {name}",
                    f"{count[index][row]}",
                    "give rows that belong together the same number",
                )


def lengths_agree(table: Table, context: Context) -> None:
    """Both rows of a pair say the same length."""
    if "pair" in context.kind.columns:
        order = np.argsort(table.columns["pair"], kind="stable").reshape(-1, 2)
        length = table.columns["length_mm"][order]
        row = first(np.abs(np.diff(length)).ravel() > 1e-6)
        if row is not None:
            raise complaint(
                table.where(order[row, 1], "length_mm"),
                f"{length[row, 0]:g}, as in the pair's other row",
                f"{length[row, 1]:g}",
                "give both rows of a pair the length between them",
            )


def some_row_moves(table: Table, context: Context) -> None:
    """At least one row belongs to the arm; a target of which poses are measured may stand still."""
    if context.measures == "target-pose":
        return
    if "fixed_to" in table.columns and not np.any(table.columns["fixed_to"] == "tool"):
        raise complaint(
            f"{table.called}, column fixed_to",
            "rows of the tool",
            "none",
            "add the rows of the tool",
        )


RULES = (
    has_columns,
    joints_are_named,
    joints_match_robot,
    numbers_are_finite,
    flange_is_whole,
    integers_are_whole,
    samples_are_unique,
    lengths_are_positive,
    physical_bounds,
    approach_is_a_sign,
    fixed_to_is_known,
    directions_are_unit,
    balls_are_known,
    groups_constrain,
    lengths_agree,
    some_row_moves,
)
"""Every rule, in the order in which a user should hear of it."""


def check_samples(table: Table, context: Context) -> None:
    """Run every rule. Raises InputError."""
    for rule in RULES:
        rule(table, context)


def points_of(table: Table) -> np.ndarray | None:
    """(n, 3) measured points, mm, or None where the kind has none."""
    return (
        np.stack([table.columns[c] for c in POINT], axis=1)
        if set(POINT) <= set(table.columns)
        else None
    )
