"""Write tests/slow_tests.txt, the tests that `make test` leaves out because they take long.

Usage: python tools/slow_tests.py REPORT.xml [SECONDS]
`make test-times` makes the report, in the format of JUnit, and runs this.
Tests that are marked as slow or long in their file need not be listed and do no harm.
"""

import sys
import xml.etree.ElementTree as xml
from pathlib import Path

LIST = Path(__file__).resolve().parent.parent / "tests" / "slow_tests.txt"
LIMIT_S = 0.7  # some 6,000 tests below it take five minutes on two cores


def slow_tests(report: Path, limit_s: float = LIMIT_S) -> list[str]:
    """Identifiers of the tests of a JUnit report that took longer, with their set-up, in alphabetical order."""
    cases = xml.parse(report).getroot().iter("testcase")
    return sorted(identifier(case) for case in cases if float(case.get("time")) > limit_s)


def identifier(case: xml.Element) -> str:
    """A test as pytest names it: tests/test_x.py::test_y[case]."""
    return f"{case.get('classname').replace('.', '/')}.py::{case.get('name')}"


def main(report: str, limit_s: str = str(LIMIT_S)) -> None:
    """Replace the list."""
    found = slow_tests(Path(report), float(limit_s))
    LIST.write_text("\n".join(found) + "\n", encoding="utf-8")
    print(f"{LIST}: {len(found)} tests above {float(limit_s):g} s")


if __name__ == "__main__":
    main(*sys.argv[1:])
