"""The engine of a diagnosis: searches unmodelled effects of a fitted baseline, and validates them.

`workbench.explanation` calls it and writes the answer. The development page lists the steps in the code.
"""

from workbench.diagnosis.linear.candidates import Candidate, Scan, Site
from workbench.diagnosis.linear.problem import Bench, Finding, Found, Located, Problem

__all__ = [
    "Bench",
    "Candidate",
    "Finding",
    "Found",
    "Located",
    "Problem",
    "Scan",
    "Site",
]
