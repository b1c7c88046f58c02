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
    fits = [{"name": f"reading {k}", "rms_mm": 1.0 + 0.1 * k, "rms_deg": 0.1} for k in range(30)]
    text = shown(fits, {})
    assert "reading 7" in text and "reading 8" not in text
    assert "22 other interpretations fit worse" in text


def test_the_column_that_joins_the_tables_is_named():
    text = shown([], {"join": {"by": "key", "key": "Nr"}})
    assert "join" in text and "Nr" in text


def shown_fits(*fits) -> str:
    return shown([dict(zip(("name", "rms_mm", "rms_deg"), fit)) for fit in fits], {})


def test_readings_that_fit_far_worse_are_counted_only():
    said = shown_fits(("a", 0.05, 0.01), ("b", 21.0, 1.5), ("c", 22.0, 1.6), ("d", 89.0, 18.0))
    assert "21" in said and "89" not in said and "2 other interpretations fit worse" in said
    said = shown_fits(("a", 0.05, 0.01), ("b", 0.06, 0.01), ("c", 0.07, 0.01))
    assert "0.07" in said and "other interpretations" not in said


def test_degrees_are_shown_where_orientations_were_compared():
    assert "RMS deg" in shown_fits(("a", 0.05, 0.01), ("b", 0.5, 0.1))
    assert "RMS deg" not in shown_fits(("a", 0.05, None), ("b", 0.5, None))
