"""Recordings for the Python API: read from a folder or by name."""


def read(recording, trust_data: bool = False):
    """The recording in a folder, or of a known name. Raises InputError."""
    import datasets

    return datasets.read(recording, trust_data)


def load_example(name: str = "elastic-arm"):
    """A recording that comes with the workbench, or another known one. Raises InputError."""
    return read(name)
