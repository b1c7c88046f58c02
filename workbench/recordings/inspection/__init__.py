"""Judges a recording before any fit: `coverage` of joints and workspace, `repeats` and the noise that they show, `needs`
of every command that the recording lacks. `inspect` puts them together."""

from workbench.recordings.inspection.inspect import Inspection, inspect_recording

__all__ = ["Inspection", "inspect_recording"]
