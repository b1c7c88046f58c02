"""docs/glossary.md: terms and keys in order, each once; symbols and keys that it names are in the code and in answers."""

import re
from importlib import import_module
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[1] / "docs" / "glossary.md"
ROOT = Path(__file__).parents[1]


def table(heading: str) -> list[list[str]]:
    """Cells of the rows of the table below a heading, without its first row."""
    section = PAGE.read_text(encoding="utf-8").split(f"## {heading}\n")[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|\n").split("|")] for line in lines][1:]


ROWS = table("Terms")
KEYS = [
    key for row in table("Keys of the JSON answers") for key in re.findall(r"`([\w.]+)`", row[0])
]
# Keys of answers that are the name of their content, or that the glossary has as a term.
PLAIN = """beyond_limits_rows command configurations converged corrected corrected_count count coverage_factor
correction_rms_mm expanded_uncertainty_max_mm fit group_names held_out input joint_curves joints largest_correction_deg
largest_correction_mm measures nominal nominal_error_mm noise noise_mm observability options outcome parameters point
position_left_rms_mm provenance reached recording rotation_left_rms_deg run samples selection sigma_rms_mm solution
stages stiffness targets terms unattainable unattainable_rows uncertainty_rms_mm unreached_rows verdict warnings
why_expected""".split()
PLACES = " ".join(row[1] for row in ROWS)
SYMBOLS = sorted(set(re.findall(r"`((?:workbench|datasets|sensors|robot_model)\.[\w.]+)`", PLACES)))


def test_terms_are_in_order_and_unique():
    terms = [row[0].lower() for row in ROWS]
    assert terms == sorted(set(terms))
    assert all(len(row) == 4 and row[2].endswith(".") for row in ROWS)


@pytest.mark.parametrize("symbol", SYMBOLS)
def test_every_symbol_exists(symbol):
    parts = symbol.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found = import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        break
    for name in parts[count:]:
        known = getattr(found, "__annotations__", {})
        assert hasattr(found, name) or name in known, symbol
        found = getattr(found, name, None)


def test_every_key_is_unique_and_in_order():
    first = [re.search(r"`([\w.]+)`", row[0])[1] for row in table("Keys of the JSON answers")]
    assert first == sorted(set(first))


@pytest.mark.parametrize("key", KEYS)
def test_every_key_is_written_by_a_command(key):
    """As a text, as the name of a field, or with the unit of a diagnosis added."""
    for folder in ("workbench", "sensors"):
        for path in (ROOT / folder).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if re.search(
                rf"""["']{key}(_\{{unit\}})?["']|\b{key}=|^    {key}: """, text, re.MULTILINE
            ):
                return
    pytest.fail(f"no command writes the key {key}; remove it from docs/glossary.md")


def test_every_key_of_a_calibration_and_a_correction_is_explained(tmp_path):
    import workbench as wb

    calibration = wb.calibrate("elastic-arm", plan="base-and-tool", folds=2, no_report=True)
    targets = tmp_path / "targets.csv"
    targets.write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n0,-20,30,0,40,0\n")
    corrected = calibration.compensate(targets, force=True)
    for result in (calibration, corrected):
        unknown = {key for key in result.answer if key not in KEYS and key not in PLAIN}
        assert not unknown, "explain these keys in docs/glossary.md"
