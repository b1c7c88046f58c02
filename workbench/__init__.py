"""Calibration of vision sensors and of the robots that carry them, from recordings.

    import workbench as wb

    recording = wb.load_example("elastic-arm")
    calibration = wb.calibrate(recording)
    calibration.held_out.rms_mm

Every command but `open` is a function of the same name (`_` for `-`; `hand_eye`, `import_data`). Names are
imported when they are first used: `import workbench` loads none of the large libraries.
"""

from importlib import import_module

from workbench.core import VERSION as __version__

_HOMES = {
    "Effect": "workbench.core.effect",
    "Fit": "workbench.core.least_squares.solver",
    "InputError": "workbench.core.errors",
    "Model": "workbench.core.model",
    "Parameters": "workbench.core.parameters",
    "Recording": "workbench.api.recordings",
    "Result": "workbench.api.results",
    "Solution": "workbench.core.solution",
    "Stage": "workbench.core.solution",
    "load": "workbench.api.functions",
    "load_example": "workbench.api.recordings",
    "read": "workbench.api.recordings",
}
_FUNCTIONS = (
    "calibrate",
    "calibrate_large",
    "camera",
    "check",
    "compare",
    "compensate",
    "datasets",
    "demo",
    "diagnose",
    "doctor",
    "evaluate",
    "export",
    "hand_eye",
    "identifiability",
    "import_data",
    "new",
    "poses",
    "prove",
    "register",
    "render",
    "scan",
    "scanner",
    "significance",
    "simulate",
    "stiffness",
    "study",
)

__all__ = ["__version__", *_HOMES, *_FUNCTIONS]


def __getattr__(name: str):
    """The public name `name`, imported from where it is defined at its first use."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    if name in _FUNCTIONS:
        return import_module("workbench.api.functions").function(name)
    raise AttributeError(f"module 'workbench' has no attribute {name!r}")


def __dir__():
    """The public names, imported or not."""
    return sorted(__all__)
