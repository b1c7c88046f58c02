"""`python -m workbench` and the `workbench` script: the same commands."""

import gc
import signal
import sys

COLLECTED_AFTER = (100_000, 50, 100)
"""New containers before Python searches for cycles, younger searches before an older generation's.

With Python's 700, these searches take an eighth of a short command: loading the libraries makes
many lasting objects and no cycles worth a search. Arrays are not containers: a cycle that holds
some is found later, which peak memory of calibrations and diagnoses does not show.
"""


def main() -> None:
    """Run the command line and leave with its exit status, whether or not anybody reads what it prints."""
    from workbench.machine.standard_streams import finish, make_tolerant

    gc.set_threshold(*COLLECTED_AFTER)
    stop_on_every_signal()
    make_tolerant()  # before the commands are loaded: they ask standard output whether it is a terminal
    from workbench.commands.cli import run
    from workbench.core.memory import keep_freed_memory

    keep_freed_memory()
    status = run()
    if problem := finish():
        print(problem, file=sys.stderr)
        status = status or 2
    gc.freeze()  # the memory goes with the process; a last search for cycles in it would take half a second
    sys.exit(status)


def stop_on_every_signal() -> None:
    """Let SIGTERM and SIGHUP stop a command as Ctrl-C does, so that worker processes end with it."""
    for name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, name):  # Windows has no SIGHUP
            signal.signal(getattr(signal, name), signal.default_int_handler)


if __name__ == "__main__":
    main()
