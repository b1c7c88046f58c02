"""Checks of the installation, each with the command that fixes it."""

import ctypes
import os
import platform
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from importlib import import_module, metadata
from pathlib import Path

# import name -> the distributions that may bring it
LIBRARIES = {
    "numpy": ("numpy",),
    "pandas": ("pandas",),
    "scipy": ("scipy",),
    "torch": ("torch",),
    "kornia": ("kornia",),
    "cv2": ("opencv-contrib-python-headless",),
    "skimage": ("scikit-image",),
    "open3d": ("open3d-cpu", "open3d"),
    "pyvista": ("pyvista",),
    "plotly": ("plotly",),
    "jinja2": ("jinja2",),
    "typer": ("typer",),
    "rich": ("rich",),
    "pydantic": ("pydantic",),
    "pyarrow": ("pyarrow",),
    "yaml": ("pyyaml",),
    "tomli_w": ("tomli-w",),
    "threadpoolctl": ("threadpoolctl",),
}
PROJECT = "vision-sensor-workbench"


@dataclass(frozen=True)
class Extra:
    """An optional package: its `distribution`, the `extra` of this project that installs it, and what `needs` it."""

    distribution: str
    extra: str
    needs: str

    @property
    def command(self) -> str:
        """The command that installs it."""
        return f"{Path(sys.executable).name} -m pip install '{PROJECT}[{self.extra}]'"


OPTIONAL = {
    "mujoco": Extra(
        "mujoco", "proof", "`workbench prove`, for the simulator of the blind benchmark"
    ),
    "distributed": Extra(
        "distributed", "study", "`workbench study --scheduler`, for a Dask cluster"
    ),
    "SALib": Extra(
        "SALib", "study", "`workbench study` with Sobol' indices, such as uncertainty-sources"
    ),
    "openpyxl": Extra("openpyxl", "import", "`workbench import` of Excel workbooks"),
    "rosbags": Extra("rosbags", "import", "`workbench import` of ROS bags"),
    "h5py": Extra("h5py", "import", "`workbench import` of MATLAB files of version 7.3"),
    "trame": Extra("trame", "app", "`workbench open`, for the local app"),
    "trame_vuetify": Extra("trame-vuetify", "app", "`workbench open`, for the local app"),
    "trame_plotly": Extra("trame-plotly", "app", "`workbench open`, for the local app"),
}
# what Open3D and VTK load from a Linux system, and the Debian package that has it
SHARED = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libidn2.so.0": "libidn2-0",
    "libudev.so.1": "libudev1",
}


@dataclass(frozen=True)
class Check:
    """One check: the finding, whether it is sufficient, and advice if it is not."""

    name: str
    ok: bool
    found: str
    required: bool = True
    advice: str = ""


def examine() -> list[Check]:
    """Run all checks; loads each library once, which takes some seconds."""
    return [
        _python(),
        *_shared_libraries(),
        *(_library(name, modules, True) for name, modules in LIBRARIES.items()),
        *(_optional(name, extra) for name, extra in OPTIONAL.items()),
        _device(),
        _recordings(),
        _writing(Path.cwd()),
    ]


def as_json(checks: Sequence[Check]) -> dict:
    """The object of `doctor --json`; `healthy` is false where something required is missing."""
    healthy = all(check.ok for check in checks if check.required)
    return {
        "command": "doctor",
        "healthy": healthy,
        "checks": [asdict(check) for check in checks],
        "apt": apt_command(checks),
    }


def apt_command(checks: Sequence[Check]) -> str | None:
    """The one command that installs every system package found missing, or None."""
    packages = [SHARED[check.name] for check in checks if check.name in SHARED and not check.ok]
    if packages:
        return f"{_sudo()}apt-get install -y {' '.join(packages)}"
    return None


def _sudo() -> str:
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        return ""
    return "sudo "


def _python() -> Check:
    return Check(
        "Python",
        sys.version_info >= (3, 11),
        platform.python_version(),
        advice="Install Python 3.11 or newer and make the environment with it.",
    )


def _shared_libraries() -> list[Check]:
    if sys.platform == "linux":
        return [_shared(name) for name in SHARED]
    return []


def _shared(name: str) -> Check:
    try:
        ctypes.CDLL(name)
    except OSError as error:
        return Check(name, False, str(error), advice=f"{_sudo()}apt-get install -y {SHARED[name]}")
    return Check(name, True, "loads")


def _library(name: str, modules: Sequence[str], required: bool) -> Check:
    try:
        import_module(name)
    except Exception as error:  # a broken wheel raises anything
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        return Check(name, False, reason, required, _remedy(name, modules, error))
    return Check(name, True, _version(modules), required)


def _optional(name: str, extra: Extra) -> Check:
    found = _library(name, (extra.distribution,), False)
    if found.ok:
        return found
    return replace(found, advice=f"Only needed by {extra.needs}: {extra.command}")


def missing_package(error: ImportError) -> str | None:
    """One sentence on a package or system library that a command needs and that does not load; None otherwise."""
    name = (error.name or "").partition(".")[0]
    if name in OPTIONAL:
        extra = OPTIONAL[name]
        return (
            f"The package {extra.distribution} is not installed, which is needed by {extra.needs}; "
            f"type {extra.command} and run the command again."
        )
    is_known = name in LIBRARIES and isinstance(error, ModuleNotFoundError)
    if not is_known and not any(soname in str(error) for soname in SHARED):
        return None
    remedy = _remedy(name, LIBRARIES.get(name, (name,)), error)
    return (
        f"The package {name or 'of this command'} does not load ({' '.join(str(error).split())[:120]}), and every part "
        f"of the workbench may need it; type {remedy}, then `workbench doctor` to see what else is missing."
    )


def _remedy(name: str, modules: Sequence[str], error: Exception) -> str:
    packages = [package for soname, package in SHARED.items() if soname in str(error)]
    if packages:
        return f"{_sudo()}apt-get install -y {' '.join(packages)}"
    return f"{Path(sys.executable).name} -m pip install {modules[0]}"


def _version(modules: Sequence[str]) -> str:
    for distribution in modules:
        try:
            return metadata.version(distribution)
        except metadata.PackageNotFoundError:
            continue
    return "version unknown"


def _device() -> Check:
    advice = "Nothing need be done: everything runs on the processor."
    try:
        import torch
    except Exception:
        return Check("torch device", False, "torch does not load", False)
    if torch.cuda.is_available():
        return Check("torch device", True, torch.cuda.get_device_name(0), False)
    if torch.backends.mps.is_available():
        return Check("torch device", True, "Apple GPU (mps)", False)
    return Check("torch device", True, f"CPU, {torch.get_num_threads()} threads", False, advice)


def _recordings() -> Check:
    try:
        from datasets import registry

        found = [row["name"] for row in registry.listing() if row["folder"]]
    except Exception as error:
        return Check("recordings", False, f"{type(error).__name__}: {error}", False)
    return Check(
        "recordings",
        bool(found),
        ", ".join(found) or "none",
        False,
        "Set WORKBENCH_RECORDINGS to the folder that holds them.",
    )


def _writing(folder: Path) -> Check:
    try:
        with tempfile.TemporaryFile(dir=folder):
            return Check("write permission", True, str(folder))
    except OSError as error:
        return Check(
            "write permission",
            False,
            f"{folder}: {error.strerror}",
            advice="Change to a folder that you may write, or use --out.",
        )
