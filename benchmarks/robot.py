"""Speed of the arm against pybotics, Pinocchio and figaroh: one table, status 1 where answers differ.

Both sides answer the same question in the same process on one thread, and their answers are
compared before their times are. Run `python benchmarks/robot.py` in an environment with
the extra `bench`; `make bench` makes one.
"""

import argparse
import os
import sys
from pathlib import Path

THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)


def main(arguments: list[str] | None = None) -> int:
    """Print the table; 1 where the two sides of a row give different answers, else 0."""
    parser = argparse.ArgumentParser(
        prog="benchmarks/robot.py", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "--only", default="", metavar="WORD", help="only the rows whose name holds WORD"
    )
    options = parser.parse_args(arguments)
    os.environ.update(dict.fromkeys(THREADS, "1"))  # read by numpy when it is first imported, below
    root = str(Path(__file__).resolve().parents[1])
    if root not in sys.path:
        sys.path.insert(0, root)
    from benchmarks import table
    from benchmarks.rows import comparisons
    from workbench.core.memory import keep_freed_memory

    keep_freed_memory()  # as the command line does
    chosen = [row for row in comparisons() if options.only in row.__name__]
    return table.show(chosen)


if __name__ == "__main__":
    sys.exit(main())
