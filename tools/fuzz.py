"""Fuzz every reader and command: `python tools/fuzz.py --inputs 20000 --minutes 10`.

Exit status 1 where an input causes anything but a value or an InputError. Such inputs are kept in the
folder `--keep`, for a regression test.
"""

import argparse
import resource
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

MEMORY_GB = 12


def main() -> int:
    """Parse the arguments, run, and print one line for every kind of failure."""
    from fuzz_engine import fuzz
    from fuzz_targets import targets

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="part of the names of the targets")
    parser.add_argument("--readers", action="store_true", help="no commands")
    parser.add_argument("--keep", type=Path, default=Path("runs/fuzz"))
    given = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_GB * 10**9, -1))
    with tempfile.TemporaryDirectory() as home:
        chosen = [t for t in targets(Path(home), not given.readers) if given.only in t.name]
        outcome = fuzz(chosen, given.inputs, 60 * given.minutes, given.seed)
    given.keep.mkdir(parents=True, exist_ok=True)
    for number, (failure, content) in enumerate(sorted(outcome.failures.items()), 1):
        (given.keep / f"{number}.bin").write_bytes(content)
        print(f"{given.keep / f'{number}.bin'}: {failure}")
    print(
        f"{outcome.inputs} inputs, {len(chosen)} targets: {outcome.accepted} accepted, "
        f"{outcome.refused} refused, {outcome.failed} failed ({len(outcome.failures)} kinds)"
    )
    return 1 if outcome.failures else 0


if __name__ == "__main__":
    sys.exit(main())
