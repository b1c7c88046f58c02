"""Standard output and standard error that a closed pipe, a closed descriptor or a full disk cannot break.

A command has done its work when it prints. Its result and its exit status must not depend on whether somebody still
reads: `workbench compensate … | head -1` ends with the status that it has without the pipe.
"""

import io
import os
import sys
from typing import TextIO


class _Tolerant(io.FileIO):
    """A descriptor whose reader may go away: what is written after that is dropped."""

    problem: OSError | None = None
    """Why something that somebody waits for could not be written; None for a pipe that was closed."""

    def write(self, content) -> int:
        try:
            return super().write(content)
        except OSError as error:
            if not isinstance(error, BrokenPipeError):
                self.problem = error
            _send_to_null(self.fileno())
            return len(content)


def make_tolerant() -> None:
    """Replace sys.stdout and sys.stderr, and give closed descriptors 0, 1 and 2 a place to go.

    Without that the next file that is opened would take the number of standard output, and what a library prints
    would be written into it.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            _send_to_null(descriptor)
    sys.stdout = _open_tolerant(sys.stdout, 1)
    sys.stderr = _open_tolerant(sys.stderr, 2)


def finish() -> str:
    """Write what is still held back; a sentence where standard output could not be written, else ""."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    problem = getattr(raw, "problem", None)
    if problem is None:
        return ""
    return (
        f"Standard output cannot be written, because the system says '{problem.strerror}', so that part of the answer "
        "is lost; make room, or write it to another place with --json FILE."
    )


def _open_tolerant(stream: TextIO | None, descriptor: int) -> TextIO:
    encoding = getattr(stream, "encoding", None) or "utf-8"
    errors = getattr(stream, "errors", None) or "strict"
    raw = _Tolerant(descriptor, "w", closefd=False)
    buffered = io.BufferedWriter(raw)
    is_immediate = descriptor == 2 or raw.isatty()
    return io.TextIOWrapper(buffered, encoding=encoding, errors=errors, line_buffering=is_immediate)


def _send_to_null(descriptor: int) -> None:
    null = os.open(os.devnull, os.O_RDWR)
    if null != descriptor:
        os.dup2(null, descriptor)
        os.close(null)
