"""The engine of a diagnosis: what physics a fitted baseline leaves out is searched, named and proved.

`workbench.explanation` asks for it and makes an answer of what it finds.
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
