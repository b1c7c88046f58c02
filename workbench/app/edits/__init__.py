"""Edits of a calibration: single changes, the session that lists them, and what they do to recording and plan."""
