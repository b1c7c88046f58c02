"""A `workbench` command in a process of its own: its progress line by line, and a way to stop it."""

import atexit
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from pathlib import Path

RUNNING = "running"
DONE = "done"
FAILED = "failed"
CANCELLED = "cancelled"
PROGRESS = "WORKBENCH_PROGRESS"
_PATIENCE_S = 5.0
_KEPT = 200


class Job:
    """One running command.

    words: the command line after `workbench`; out: the run folder that it writes, which is new or empty.
    The process runs in `folder`. Its last lines are in `lines`. `is_cancelled`: someone asked it to stop.
    """

    def __init__(self, words: list[str], out: Path, folder: Path):
        self.out = out
        self.lines: deque[str] = deque(maxlen=_KEPT)
        self.started = time.monotonic()
        self.is_cancelled = False
        self._is_removing = False
        self._process = subprocess.Popen(
            [sys.executable, "-m", "workbench", *words, "--out", str(out)],
            cwd=folder,
            env={**os.environ, PROGRESS: "lines"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=os.name == "posix",
        )
        atexit.register(self.cancel)  # a run does not go on without the app that shows it
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def state(self) -> str:
        """ "running", "done" (the run folder is complete), "failed" or "cancelled" (and its folder is removed)."""
        if self._process.poll() is None or self._is_removing:
            return RUNNING
        if self.is_cancelled:
            return CANCELLED
        return DONE if (self.out / "answer.json").is_file() else FAILED

    @property
    def last_line(self) -> str:
        """Last line of the command's output."""
        return self.lines[-1] if self.lines else ""

    @property
    def seconds(self) -> float:
        """Seconds since the command started."""
        return time.monotonic() - self.started

    def cancel(self) -> None:
        """Interrupt the command, and remove what it has written so far.

        A command that does not end in time, as on a busy machine, is killed. It removes its folder itself, but for an
        interruption between making the folder and entering it.
        """
        if self._process.poll() is not None:
            return
        self.is_cancelled = self._is_removing = True
        try:
            self._end()
            shutil.rmtree(self.out, ignore_errors=True)
        finally:
            self._is_removing = False

    def _end(self) -> None:
        """Interrupt the command; kill it where it does not end in time."""
        self._signal(signal.SIGINT)
        try:
            self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._signal(signal.SIGKILL if os.name == "posix" else signal.SIGTERM)
            self._process.wait(_PATIENCE_S)

    def wait(self, timeout: float | None = None) -> str:
        """Wait until the command has ended; its state."""
        self._process.wait(timeout)
        atexit.unregister(self.cancel)
        self._reader.join(_PATIENCE_S)
        return self.state

    def _signal(self, number: int) -> None:
        """Send a signal to the command and the processes that it started."""
        if os.name == "posix":
            os.killpg(self._process.pid, number)
        else:
            self._process.terminate()

    def _read(self) -> None:
        for line in self._process.stderr:
            text = " ".join(line.split())
            if text:
                self.lines.append(text)
