"""What every test file shares: where real recordings lie, one thread a worker, slow tests first."""

import os

# Before numpy is loaded: workers with many threads each only get in each other's way.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import fcntl  # noqa: E402
import json  # noqa: E402
import select  # noqa: E402
import shutil  # noqa: E402
import signal  # noqa: E402
import subprocess  # noqa: E402
import sys  # noqa: E402
from pathlib import Path  # noqa: E402

import pytest  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent


def recordings_folder() -> Path:
    """Where real recordings lie: WORKBENCH_RECORDINGS, else shared/recordings next to the project."""
    setting = os.environ.get("WORKBENCH_RECORDINGS")
    return Path(setting) if setting else ROOT.parent / "shared" / "recordings"


def mostly_slow(cases, fast: int, slow: int | None = None) -> list:
    """`cases` for parametrize, of which `fast`, evenly spread, belong to the fast tests and all others to the slow.

    Where `slow` is given, so many of the others, evenly spread, are slow and the rest are long: cases that show the
    same once more.
    """
    cases = list(cases)
    kept = _spread(range(len(cases)), fast)
    others = [k for k in range(len(cases)) if k not in kept]
    once = others if slow is None else _spread(others, slow)
    marks = {k: pytest.mark.slow if k in once else pytest.mark.long for k in others}
    return [_marked(case, marks[k]) if k in marks else case for k, case in enumerate(cases)]


def sizes(slow: int, whole: int) -> list:
    """Sizes of a statistical study for parametrize: one of the slow tests, and the whole one of the long tests."""
    return [
        pytest.param(slow, marks=pytest.mark.slow),
        pytest.param(whole, marks=pytest.mark.long),
    ]


def _spread(places, count: int) -> set:
    """`count` of the places, evenly spread from the first to the last."""
    places = list(places)
    return {places[round(k * (len(places) - 1) / max(count - 1, 1))] for k in range(count)}


def _marked(case, mark):
    """One case of parametrize, plain or made by `pytest.param`, with a mark."""
    if hasattr(case, "marks"):
        return pytest.param(*case.values, id=case.id, marks=mark)
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=mark)


@pytest.hookimpl(tryfirst=True)  # before pytest selects by marks
def pytest_collection_modifyitems(items):
    """Tests of `slow_tests.txt` are slow, too. Files with slow ones start first, lest one worker is left alone at the end.

    A file stays in one piece: its fixtures, many of them a run of a command, are made once.
    """
    measured = set((ROOT / "tests" / "slow_tests.txt").read_text(encoding="utf-8").splitlines())
    for item in items:
        if item.nodeid in measured:
            item.add_marker(pytest.mark.slow)
    have_slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in have_slow)


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


class CommandServer:
    """The process of `command_server`, started with the first command and again after a timeout."""

    def __init__(self):
        self.process, self.environment = None, {}

    def __call__(self, words, cwd, timeout, environment, scratch) -> int:
        """Exit status of a command whose streams go to files in `scratch`."""
        streams = {name: str(scratch / name) for name in ("stdout", "stderr")}
        for path in streams.values():
            Path(path).touch()
        self._ask({"words": words, "cwd": str(cwd), **streams}, environment)
        return int(self._line(words, timeout))

    def start(self, words, cwd, stdout, stderr, loaded=()) -> int:
        """Process id of a command that goes on, its streams opened for writing; `loaded`: modules that it needs."""
        request = {"words": words, "cwd": str(cwd), "stdout": str(stdout), "stderr": str(stderr)}
        more = {"goes_on": True, "loaded": list(loaded)}
        self._ask(request | more, command_environment())
        return int(self._line(words, 300))

    def _ask(self, request, environment):
        if self.process is None or self.environment != environment:
            self._start(environment)
        whole = {"goes_on": False, "loaded": [], "environment": environment, **request}
        self.process.stdin.write(json.dumps(whole) + "\n")
        self.process.stdin.flush()

    def _start(self, environment):
        self.stop()
        self.process = subprocess.Popen(
            [sys.executable, str(ROOT / "tests" / "command_server.py")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
            start_new_session=True,
        )
        self.environment = environment
        self._line("start", 300)

    def _line(self, words, timeout) -> str:
        if not select.select([self.process.stdout], [], [], timeout)[0]:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.stop()
            raise subprocess.TimeoutExpired(words, timeout)
        return self.process.stdout.readline()

    def stop(self):
        if self.process is not None:
            self.process.stdin.close()
            self.process.stdout.close()
            self.process.wait(30)
            self.process = None


COMMANDS = CommandServer()
"""One process for each worker of the tests, from which the commands are forked."""


def command_environment() -> dict[str, str]:
    """Environment variables of a command that a test runs: those of the tests, with the checkout to import from."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment.pop("PYTEST_CURRENT_TEST", None)
    return environment


@pytest.fixture(scope="session")
def command_server():
    """The process from which the commands are forked, for the time of the session."""
    yield COMMANDS
    COMMANDS.stop()


@pytest.fixture
def workbench(tmp_path, tmp_path_factory, command_server):
    """`workbench("calibrate", …)` runs a command in a process of its own, in an empty folder."""

    def call(*words, cwd: Path = tmp_path, timeout: float = 100) -> subprocess.CompletedProcess:
        words, scratch = [str(word) for word in words], tmp_path_factory.mktemp("streams")
        status = command_server(words, cwd, timeout, command_environment(), scratch)
        texts = [(scratch / name).read_text(encoding="utf-8") for name in ("stdout", "stderr")]
        return subprocess.CompletedProcess(words, status, *texts)

    return call


def made_once(tmp_path_factory, name: str, make) -> Path:
    """What `make(folder)` returns for a new folder; one of the workers makes it, the others wait for it."""
    root = tmp_path_factory.getbasetemp()
    root = root.parent if "PYTEST_XDIST_WORKER" in os.environ else root
    folder, result = root / name, root / f"{name}.txt"
    with (root / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not result.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            result.write_text(str(make(folder)), encoding="utf-8")
    return Path(result.read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def browser():
    """Playwright's browser for the tests of the app; they are skipped where it is absent."""
    import app_browser

    started, browser = app_browser.chromium()
    yield browser
    browser.close()
    started.stop()


@pytest.fixture(scope="session")
def arm_run(tmp_path_factory):
    """A run of `workbench calibrate` on the bundled arm."""
    import app_browser

    return made_once(
        tmp_path_factory, "arm", lambda folder: app_browser.calibrate_arm("elastic-arm", folder)
    )


@pytest.fixture(scope="session")
def solved_arm(tmp_path_factory):
    """A run folder of the bundled arm with stages given as values, as `workbench calibrate` writes it."""
    import datasets
    from workbench.commands.robot.calibration_run import solve_into
    from workbench.core.solution import Stage

    stages = (
        Stage("geometry", "lengths", free=("base.*", "sensor.*", "joint-*.theta*"), earn=False),
        Stage("compliance", "joints deflect", (("joint-compliance", "joint-2", {}),)),
    )
    folder, name = tmp_path_factory.mktemp("solved"), "elastic-arm"
    options = {"plan": stages, "folds": 3}
    solve_into(folder, folder, datasets.read(name), name, options, lambda text: None, False)
    return folder


@pytest.fixture(scope="session")
def hand_eye_run(tmp_path_factory):
    """A run of `workbench handeye` on the template of images of a board, which lies next to it."""
    import app_browser

    return made_once(tmp_path_factory, "hand-eye", app_browser.calibrate_hand_eye)


@pytest.fixture(scope="session")
def scanner_run(tmp_path_factory):
    """A run of `workbench calibrate` on a rendered recording of a line scanner on an arm."""
    import app_browser

    return made_once(tmp_path_factory, "scanner", app_browser.calibrate_scanner)
