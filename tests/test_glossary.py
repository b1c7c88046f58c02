"""docs/glossary.md: terms in order, each once, and every symbol that it names is in the code."""

import re
from importlib import import_module
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[1] / "docs" / "glossary.md"
ROWS = [
    [cell.strip() for cell in line.strip("|\n").split("|")]
    for line in PAGE.read_text(encoding="utf-8").splitlines()
    if line.startswith("| ")
][1:]
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
