"""`python -m workbench` and the `workbench` script: the same commands."""

import sys


def main() -> None:
    """Run the command line and leave with its exit status."""
    from workbench.cli import run
    from workbench.core.memory import keep_freed_memory

    keep_freed_memory()
    sys.exit(run())


if __name__ == "__main__":
    main()
