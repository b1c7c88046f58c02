"""The bench: from recordings to calibrated sensors and robots, and to what their models miss.

Names are handed on lazily, so that `import workbench` costs milliseconds and loads none of the
large libraries.
"""

from importlib import import_module

from workbench._version import VERSION as __version__

_HOMES = {
    "Effect": "workbench.core.effect",
    "InputError": "workbench.core.errors",
    "Model": "workbench.core.model",
    "Parameters": "workbench.core.parameters",
    "Fit": "workbench.core.least_squares.solver",
    "Solution": "workbench.core.solution",
    "Stage": "workbench.core.solution",
}
_MODULES = {
    "calibrate": "workbench.jobs.calibrate",
    "core": "workbench.core",
    "identify": "workbench.jobs.identify",
    "report": "workbench.report",
    "simulate": "workbench.jobs.simulate",
}

__all__ = ["__version__", *_HOMES, *_MODULES]


def __getattr__(name: str):
    """The public name `name`, imported from where it lives at its first use."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    if name in _MODULES:
        return import_module(_MODULES[name])
    raise AttributeError(f"module 'workbench' has no attribute {name!r}")


def __dir__():
    """The public names, imported or not."""
    return sorted(__all__)
