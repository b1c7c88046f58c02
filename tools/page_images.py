"""Regenerate docs/images: terminals, charts and diagrams of the documentation pages.

`python tools/page_images.py` draws all (about five minutes), `python tools/page_images.py ports commands` two of them.
Terminals show what the commands print today, charts are computed by the workbench, diagrams read the catalogues.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))


def names() -> list[str]:
    """Names of all images."""
    from page_charts import CHARTS
    from page_diagrams import DIAGRAMS
    from page_terminals import TERMINALS

    return [*DIAGRAMS, *CHARTS, *TERMINALS]


def draw(name: str) -> None:
    """One image into docs/images."""
    from page_charts import CHARTS
    from page_diagrams import DIAGRAMS
    from page_terminals import write

    drawn = {**CHARTS, **DIAGRAMS}
    if name in drawn:
        drawn[name]()
    else:
        write(name)


def main(wanted: list[str]) -> int:
    """Draw the named images, all where none is named; exit status 2 for an unknown name."""
    known = names()
    unknown = [name for name in wanted if name not in known]
    if unknown:
        print(f"no image is called {unknown[0]}: expected {', '.join(known)}", file=sys.stderr)
        return 2
    for name in wanted or known:
        print(name, flush=True)
        draw(name)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
