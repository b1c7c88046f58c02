"""Runs commands of the workbench for the tests, each in a forked process that has the libraries loaded.

Loading them takes a second or more, longer than most commands that the tests run. A request is a line of JSON on
standard input; the answer is a line with the exit status. The process of a command has its own working directory,
environment, standard streams and memory, as one started from a shell.
"""

import json
import os
import sys
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
        child = os.fork()
        if child == 0:
            requests.close()
            answers.close()
            run(json.loads(line))
        _, status = os.waitpid(child, 0)
        print(os.waitstatus_to_exitcode(status), file=answers, flush=True)


def run(request: dict) -> None:
    """Become the process of one command; it ends with SystemExit."""
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

    main()


if __name__ == "__main__":
    serve()
