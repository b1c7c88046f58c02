"""Provenance of a result: versions, data and date."""

import platform
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version

from workbench.core import VERSION


def provenance(recording) -> dict[str, str]:
    """Versions, hash of the data, source and licence of a recording; no random numbers are used."""
    return {
        "workbench": VERSION,  # what an install wrote down of a checkout may be older
        "python": platform.python_version(),
        "numpy": _version("numpy"),
        "scipy": _version("scipy"),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "seed": "none: no random numbers were used",
        "data_sha256": recording.sha256,
        "data_source": recording.source,
        "data_licence": recording.licence,
        "recording": recording.name,
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
