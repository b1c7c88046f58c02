"""Recordings for the Python API: read from a folder or by name."""

from pathlib import Path

from datasets.recording import Recording
from robot_model import builtin_robots
from robot_model.files.loading import whole_keys
from workbench.core.errors import InputError
from workbench.core.robot_files.builtin_names import state_builtin_names

__all__ = ["Recording", "load_example", "read"]

# recordings may not import robots: `Recording.from_arrays` checks name and joints of a robot by what is stated here
state_builtin_names(builtin_robots, whole_keys)


def read(recording: str | Path, trust_data: bool = False) -> Recording:
    """The recording in a folder, or of a known name (`wb.datasets()` lists them).

    Args:
        recording: Folder with a recording.toml, or a known name.
        trust_data: Warn instead of refusing where the recorded data are implausible.

    Returns:
        The samples in file units (deg, mm); its properties are in rad and mm.

    Raises:
        InputError: A file is missing, or a value cannot be a measurement; the sentence names file, row and column.

    Examples:
        >>> template = wb.new("external-point", "my-robot", robot="ur10")
        >>> wb.read("my-robot").points.shape
        (36, 3)
    """
    import datasets

    if not isinstance(recording, str | Path):
        raise InputError(
            f"read, recording: expected a folder or a known name, found {recording!r}; name the folder of a "
            "recording.toml"
        )
    return datasets.read(recording, trust_data)


def load_example(name: str = "elastic-arm") -> Recording:
    """A recording that comes with the workbench, or another known one.

    Raises:
        InputError: The name is unknown, or the recording is not on this machine.

    Examples:
        >>> recording = wb.load_example("elastic-arm")
        >>> recording.n, recording.joints.shape
        (300, (300, 6))
    """
    return read(name)
