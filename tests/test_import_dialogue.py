"""What `workbench import` prints: the best readings, how many more there are, and the column that joins the tables."""

from types import SimpleNamespace

from rich.console import Console

from workbench.commands.data import import_dialogue


def shown(conventions, mapping) -> str:
    console = Console(record=True, width=120, quiet=False, file=open("/dev/null", "w"))
    answer = {
        "warnings": [],
        "images": 0,
        "measures": "external-pose",
        "samples": 3,
        "mapping": mapping,
        "conventions": conventions,
        "unused_columns": [],
    }
    result = SimpleNamespace(recording=SimpleNamespace(columns={}))
    import_dialogue.show(console, answer, result)
    return console.export_text()


def test_of_many_readings_the_best_ones_are_shown():
    fits = [{"name": f"reading {k}", "rms_mm": float(k), "rms_deg": 0.1} for k in range(30)]
    text = shown(fits, {})
    assert "reading 7" in text and "reading 8" not in text
    assert "22 other readings fit worse" in text


def test_the_column_that_joins_the_tables_is_named():
    text = shown([], {"join": {"by": "key", "key": "Nr"}})
    assert "join" in text and "Nr" in text
