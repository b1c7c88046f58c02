"""What every test file shares: where real recordings lie, one thread a worker, slow tests first."""

import os

# Before numpy is loaded: workers with many threads each only get in each other's way.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import subprocess  # noqa: E402
import sys  # noqa: E402
from pathlib import Path  # noqa: E402

import pytest  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent


def recordings_folder() -> Path:
    """Where real recordings lie: WORKBENCH_RECORDINGS, else shared/recordings beside the project."""
    setting = os.environ.get("WORKBENCH_RECORDINGS")
    return Path(setting) if setting else ROOT.parent / "shared" / "recordings"


def pytest_collection_modifyitems(items):
    """Slow tests start first, so that no worker is left alone with one at the end."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.fixture(scope="session")
def real():
    """`real(name)` is the folder of a real recording; the test is skipped where it is absent."""

    def folder(name: str) -> Path:
        place = recordings_folder() / name
        if not place.is_dir():
            pytest.skip(
                f"the real recording {name} is not in {recordings_folder()}; set WORKBENCH_RECORDINGS"
            )
        return place

    return folder


@pytest.fixture(scope="module")
def recording(real):
    """`recording("name:variant")` is the real recording; the test is skipped where it is absent."""

    def read(name: str):
        import datasets

        real(name.partition(":")[0])
        return datasets.read(name)

    return read


@pytest.fixture
def workbench(tmp_path):
    """`workbench("calibrate", …)` runs a command in a process of its own, in an empty folder."""

    def call(*words, cwd: Path = tmp_path, timeout: float = 300) -> subprocess.CompletedProcess:
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        return subprocess.run(
            [sys.executable, "-m", "workbench", *map(str, words)],
            cwd=cwd,
            text=True,
            capture_output=True,
            timeout=timeout,
            env=environment,
            check=False,
        )

    return call
