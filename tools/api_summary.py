"""Writes signatures and first sentences of the public names into docs/reference/api.md, readable without the site.

The table stands between two marks. `--check` compares.
"""

import inspect
import re
import sys
from pathlib import Path

import workbench

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "api.md"
START, END = "<!-- summary -->\n", "<!-- end of summary -->\n"
_METHODS = {
    "Recording": ("from_arrays", "select", "save"),
    "Result": ("summary", "to_frame", "plot", "report", "compensate", "export", "save"),
}
_LONGEST = 4  # parameters that are shown by name


def summary() -> str:
    """The table of all public names: functions, classes, and their methods that are most used."""
    rows = ["| name | what it does |", "|---|---|"]
    for name in workbench.__all__:
        thing = getattr(workbench, name)
        if not callable(thing):
            continue
        rows.append(_row(f"wb.{name}", thing))
        for method in _METHODS.get(name, ()):
            if hasattr(thing, method):
                rows.append(_row(f"{name}.{method}", getattr(thing, method)))
    return "\n".join([*rows, ""])


def _row(shown: str, thing) -> str:
    text = inspect.getdoc(thing) or ""
    sentence = re.split(r"(?<=[.!])\s|\n\n", " ".join(text.split("\n\n")[0].split()))[0]
    call = "" if inspect.isclass(thing) else _parameters(thing)
    return f"| `{shown}{call}` | {sentence.replace('|', chr(92) + '|')} |"


def _parameters(thing) -> str:
    names = [
        one.name if one.default is one.empty else f"{one.name}=..."
        for one in inspect.signature(thing).parameters.values()
        if one.name != "self"
    ]
    more = ", ..." if len(names) > _LONGEST else ""
    return f"({', '.join(names[:_LONGEST])}{more})"


def page(text: str) -> str:
    """The page with the present table between its marks."""
    before, _, rest = text.partition(START)
    return f"{before}{START}\n{summary()}\n{END}{rest.partition(END)[2]}"


def main() -> int:
    """Write or check; the exit status."""
    text = PAGE.read_text(encoding="utf-8")
    if "--check" not in sys.argv:
        PAGE.write_text(page(text), encoding="utf-8")
        return 0
    if text == page(text):
        return 0
    print("docs/reference/api.md is stale: run python tools/api_summary.py")
    return 1


if __name__ == "__main__":
    sys.exit(main())
