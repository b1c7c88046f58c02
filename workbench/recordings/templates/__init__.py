"""Templates: an example recording of every kind that calibrates as it is, and whose files say in comments what to change.

`examples` makes the rows with the simulator of the workbench (an arm with geometry errors of data-sheet size), `contact`
poses that touch points, planes and beams, `images` renders boards and scans, `comments` writes recording.toml.
"""

from workbench.recordings.templates.write import KINDS, Template, write_template

__all__ = ["KINDS", "Template", "write_template"]
