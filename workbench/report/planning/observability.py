"""Meaning and presentation of the observability indices O1 to O5."""

from collections.abc import Mapping, Sequence

from workbench.report.sections import table
from workbench.report.text import rounded

MEANING = {
    "O1": "geometric mean of the singular values per sample: overall information (Borm & Menq 1991)",
    "O2": "smallest over largest singular value: how even the information is (Driels & Pathre 1990)",
    "O3": "smallest singular value: information on the worst determined direction (Nahvi et al. 1994)",
    "O4": "noise amplification index, smallest squared over largest (Nahvi & Hollerbach 1996)",
    "O5": "inverse of the summed inverse singular values: mean variance (Sun & Hollerbach 2008)",
}


def meaning() -> dict:
    """A table of the five indices; larger is better in each."""
    return table(["index", "what it measures; larger is better"], MEANING.items(), left=2)


def of_stages(stages: Sequence[Mapping]) -> dict:
    """A table of the stages with free and identifiable parameters and the five indices."""
    rows = [
        (stage["name"], stage["free"], stage["identifiable"], *(rounded(stage[k]) for k in MEANING))
        for stage in stages
    ]
    return table(["stage", "free", "identifiable", *MEANING], rows)
