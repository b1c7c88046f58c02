"""Readers of foreign files, one file per format; `read_sources` chooses the reader from extension and content.

A reader returns a `datasets.importers.source.Source` and interprets nothing: names of columns stay as they are, and
only what the format itself fixes (KUKA's A, B, C are intrinsic ZYX in degrees) is stated along with the columns.
"""

from datasets.importers.sources.choice import read_sources

__all__ = ["read_sources"]
