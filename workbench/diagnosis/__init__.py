"""What physics a fitted baseline leaves out: located, named, modelled and proved."""

from workbench.diagnosis.linear.problem import (
    Bench,
    Candidate,
    Finding,
    Found,
    Located,
    Problem,
    Scan,
    Site,
)

__all__ = [
    "Bench",
    "Candidate",
    "Finding",
    "Found",
    "Located",
    "Problem",
    "Scan",
    "Site",
    "diagnose",
]


def __getattr__(name: str):
    """`diagnose`, imported only when asked for: it needs the whole workbench, and the arrays above do not."""
    if name == "diagnose":
        from workbench.diagnosis.answer import diagnose

        return diagnose
    raise AttributeError(name)
