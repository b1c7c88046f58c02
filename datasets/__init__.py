"""Measured data: the recording format, readers of public data sets, and their sources.

`read` and `write` are what everyone needs; they are looked up when first used, so that importing
this package costs nothing.
"""

from importlib import import_module

_HOME = {
    "InputError": "datasets.errors",
    "Recording": "datasets.recording",
    "read": "datasets.reading",
    "write": "datasets.formats.recording1_writer",
    "find": "datasets.registry",
    "get": "datasets.registry",
    "listing": "datasets.registry",
}
__all__ = sorted(_HOME)


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'datasets' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
