"""Templates: an example recording of every kind that calibrates as it is, with comments on what to change.

`examples` simulates the rows (an arm with geometry errors of data-sheet size), `contact` makes poses that touch
points, planes and beams, `images` renders boards and scans, `comments` writes recording.toml.
"""

from workbench.recordings.templates.write import KINDS, Template, write_template

__all__ = ["KINDS", "Template", "write_template"]
