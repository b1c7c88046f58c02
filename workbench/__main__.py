"""`python -m workbench` and the `workbench` script: the same commands."""

import gc
import signal
import sys


def main() -> None:
    """Run the command line and leave with its exit status, whether or not anybody reads what it prints."""
    from workbench.machine.standard_streams import finish, make_tolerant

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
