"""Judges a recording before any fit.

`coverage` of joints and workspace, `repeats` and the noise that they show, and `needs`: what the recording lacks for
which command. `inspect` puts them together.
"""

from workbench.recordings.inspection.inspect import Inspection, inspect_recording

__all__ = ["Inspection", "inspect_recording"]
