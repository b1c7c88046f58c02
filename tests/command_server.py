"""Runs commands of the workbench for the tests, each in a forked process that has the libraries loaded.

Loading them takes a second or more, longer than most commands that the tests run. A request is a line of JSON on
standard input; the answer is a line with the exit status, or with the process id of a command that is to go on. The
process of a command has its own working directory, environment, standard streams and memory, as one started from a
shell.
"""

import atexit
import json
import os
import sys
import threading
from importlib import import_module

PRELOADED = (
    "workbench.commands.cli",
    "workbench.__main__",
    "matplotlib.figure",
    "pandas",
    "plotly.graph_objects",
    "pyarrow.parquet",
    "scipy.optimize",
    "scipy.stats",
    "datasets",
    "workbench.jobs.robot.calibrate",
    "workbench.report.page",
)


def serve() -> None:
    """Answer requests until standard input ends."""
    for name in PRELOADED:
        import_module(name)
    requests, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    print("ready", file=answers, flush=True)
    for line in requests:
        request = json.loads(line)
        for name in request["loaded"]:
            import_module(name)
        child = os.fork()
        if child == 0:
            requests.close()
            answers.close()
            run(request)
        print(child if request["goes_on"] else exit_status(child), file=answers, flush=True)


def exit_status(child: int) -> int:
    """Of the process of a command, once it has ended."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def run(request: dict) -> None:
    """Become the process of one command, and end with its exit status.

    Once everything that is to be done at its end is done, the process leaves at once: to take apart the interpreter
    with all the libraries that were loaded takes half a second.
    """
    for stream, descriptor, flags in (
        (os.devnull, 0, os.O_RDONLY),
        (request["stdout"], 1, os.O_WRONLY | os.O_TRUNC),
        (request["stderr"], 2, os.O_WRONLY | os.O_TRUNC),
    ):
        opened = os.open(stream, flags)
        os.dup2(opened, descriptor)
        os.close(opened)
    os.chdir(request["cwd"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.argv = ["workbench", *request["words"]]
    from workbench.__main__ import main

    try:
        main()
    except SystemExit as end:
        threading._shutdown()
        atexit._run_exitfuncs()
        os._exit(end.code or 0)


if __name__ == "__main__":
    serve()
