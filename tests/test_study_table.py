"""The table that `workbench study` prints: the outcome of the study comes first, and the table says what it leaves out."""

from workbench.commands.data.study import _shown

NAMES = (
    [f"uncalibrated_test_{load}kg_mm" for load in range(4)]
    + [f"geometry_test_{load}kg{kind}_mm" for load in range(4) for kind in ("", "_max")]
    + [f"compliance_test_{load}kg{kind}_mm" for load in range(4) for kind in ("", "_max")]
)


def columns_of(outcome):
    return [
        row["column"]
        for row in _shown({"outcome": outcome, "columns": [{"column": name} for name in NAMES]})
    ]


def test_the_outcome_is_the_first_row_and_the_same_quantity_of_other_models_follows():
    shown = columns_of("geometry_test_3kg_mm")
    assert shown[:3] == [
        "geometry_test_3kg_mm",
        "uncalibrated_test_3kg_mm",
        "compliance_test_3kg_mm",
    ]
    assert len(shown) == 12 and len(set(shown)) == 12


def test_an_outcome_without_an_underscore_is_still_the_first_row():
    names = [*NAMES, "samples"]
    found = {"outcome": "samples", "columns": [{"column": name} for name in names]}
    assert _shown(found)[0] == {"column": "samples"}


def test_without_an_outcome_the_first_columns_are_shown():
    assert columns_of(None) == NAMES[:12]
