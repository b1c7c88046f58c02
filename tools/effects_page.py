"""Writes docs/effects.md from the catalogue, so that no effect is described in two places.

`python tools/effects_page.py` writes the page; `--check` says whether it is up to date (status 1).
"""

import sys
from pathlib import Path

from robot_model.effects import CATALOGUE as ROBOT
from sensors.effects import CATALOGUE as SENSOR

PAGE = Path(__file__).parents[1] / "docs" / "effects.md"
HEAD = """# Effects that a model may hold

One class an effect; this page is made from them by `python tools/effects_page.py`. A plan or a scene names an
effect by the first column. Where that is not the word of the vocabulary, the word stands in the second: it is a
variant of that effect.

## The robot's, in `robot_model/effects/`

"""
SENSOR_HEAD = """
## The scanner's, in `sensors/effects/`

Used by the renderer, the calibration and the diagnosis alike.

"""
COLUMNS = """| name | effect | sits at | port | law | source | what it is |
|---|---|---|---|---|---|---|
"""


def page() -> str:
    """The whole page."""
    return HEAD + _table(ROBOT) + SENSOR_HEAD + _table(SENSOR)


def _table(catalogue) -> str:
    return COLUMNS + "".join(_row(name, kind) for name, kind in catalogue.items())


def _row(name, kind) -> str:
    what = " ".join((kind.__doc__ or "").split("\n\n")[0].split())
    cells = (f"`{name}`", kind.effect, ", ".join(kind.places), kind.port, f"`{kind.equation}`", kind.source, what)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def main() -> int:
    """Write or check; the exit status."""
    if "--check" not in sys.argv:
        PAGE.write_text(page(), encoding="utf-8")
        return 0
    fresh = PAGE.is_file() and PAGE.read_text(encoding="utf-8") == page()
    print("docs/effects.md is up to date" if fresh else "docs/effects.md is stale: run python tools/effects_page.py")
    return 0 if fresh else 1


if __name__ == "__main__":
    sys.exit(main())
