"""The mutation table: more than 75 mistakes in five fresh recordings, and what the plausibility check says.

`python tools/mutation_table.py [--seed N] [--every K] [--only NAME]` prints one line for every mistake and a summary.
All of it takes about half an hour; `--every 10` takes every tenth mistake.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

UNDETECTABLE = ("–", "absorbed")


def main() -> int:
    """Run the table; exit status 1 where the shares of the acceptance criterion are not met."""
    from user_errors_more import FRESH

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=71)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--only", default="", help="part of the name of a recording or mistake")
    given = parser.parse_args()
    rows = [row for name in FRESH for row in outcomes(name, given)]
    return summary(rows)


def outcomes(name: str, given):
    """(recording, mistake, outcome) of the mistakes in one recording, the sound one first."""
    from robot_model import load_robot
    from user_errors_more import EVERY, FRESH, fresh
    from user_errors_page import _outcome
    from workbench.fitting.plausibility import check_plausibility

    recording = fresh(name, given.seed)
    found = check_plausibility(load_robot(recording.robot), recording)
    yield _said(name, "no mistake", "nothing" if not found else f"alarm: {found[0].cause}")
    start = list(FRESH).index(name) % given.every
    for mistake in EVERY[start :: given.every]:
        if given.only in f"{name} {mistake.name}":
            yield _said(name, mistake.name, _outcome(mistake, recording))


def _said(*row):
    print(*row, sep="\t", flush=True)
    return row


def summary(rows) -> int:
    """Print the shares; 0 where they meet the criterion."""
    from user_errors import RIGHT

    sound = Counter(outcome for _, mistake, outcome in rows if mistake == "no mistake")
    judged = [o for _, m, o in rows if m != "no mistake" and o not in UNDETECTABLE]
    right = sum(o in RIGHT for o in judged) / max(len(judged), 1)
    noticed = sum(o != "silent" for o in judged) / max(len(judged), 1)
    either = judged.count("either") / max(len(judged), 1)
    alarms = sum(sound.values()) - sound["nothing"]
    print(f"{len(judged)} detectable mistakes, alarms on sound recordings: {alarms}")
    print(
        f"right cause {right:.1%} (required 90 %), {either:.1%} as one of two that explain the data equally well"
    )
    print(f"stopped or warned {noticed:.1%} (required 99 %)")
    return int(right < 0.9 or noticed < 0.99 or alarms > 0)


if __name__ == "__main__":
    sys.exit(main())
