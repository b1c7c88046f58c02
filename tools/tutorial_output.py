"""Run the commands and the code of the tutorials, and write what they print into the pages.

`python tools/tutorial_output.py` writes all tutorials, `python tools/tutorial_output.py camera` the named ones.
tests/test_tutorials.py runs the same blocks and compares. A block of output is a ```text block behind the block that
prints it. Of a long output the page shows the beginning, the verdict and the end, with a line "..." between.
"""

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from terminal_image import COLUMNS, ROOT, link_tools

TUTORIALS = ROOT / "docs" / "tutorials"
BLOCK = re.compile(r"```(sh|python)\n(.*?)```\n(?:\n```text\n(.*?)```\n)?", re.DOTALL)
LONGEST, KEPT, GAP = 42, 24, "..."
# What another machine may print: 5 % or two units of the last printed digit more or less; 1 % of a count above 100;
# any number that is zero but for rounding errors.
RELATIVE, LAST_DIGITS, COUNTED, ZERO = 0.05, 2, 0.01, 1e-6
NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


@dataclass(frozen=True)
class Block:
    """A block of code of a page: "sh" or "python", its text, and the output that the page prints behind it."""

    language: str
    code: str
    printed: str


def blocks(page: Path) -> list[Block]:
    """The blocks of a page that run, in order."""
    found = BLOCK.finditer(page.read_text(encoding="utf-8"))
    return [Block(one[1], one[2], one[3] or "") for one in found]


def run(block: Block, folder: Path) -> str:
    """What the block prints when it runs in `folder`, without names of folders of this machine.

    Raises RuntimeError with the messages if it fails.
    """
    words = ["bash", "-euo", "pipefail", "-c", block.code]
    if block.language == "python":
        words = [sys.executable, "-c", block.code]
    tools = link_tools(folder.with_name(f"{folder.name}-bin"))
    environment = {
        **os.environ,
        "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "COLUMNS": str(COLUMNS),
    }
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{block.code}\n{done.stdout}\n{done.stderr}")
    output = done.stdout.replace(f"{folder.resolve()}/", "").replace(str(ROOT), "...")
    return re.sub(r"runs/\d{8}-\d{6}-", "runs/DATE-TIME-", output)


def shortened(output: str) -> str:
    """The output as a page prints it: long ones without their middle."""
    lines = [line.rstrip() for line in output.strip("\n").splitlines()]
    if len(lines) > LONGEST:
        verdict = next((k for k, line in enumerate(lines) if line.startswith("Verdict")), None)
        last = max(KEPT, len(lines) - 1 if verdict is None else verdict)
        lines = [*lines[:KEPT], GAP, *lines[last:]]
    return "\n".join(lines)


def difference(printed: str, output: str) -> str | None:
    """The first difference between what a page prints and an output, or None.

    White space and the length of rules do not count. Numbers with a decimal point or an exponent may differ by the
    larger of 5 % and two units of the last digit of the page, whole numbers above 100 by 1 %. Numbers below 1e-6 are
    zero. All other words and numbers are equal.
    """
    return text_difference(shortened(printed), shortened(output))


def text_difference(printed: str, output: str) -> str | None:
    """The first difference between two texts, or None; numbers may differ as in `difference`."""
    expected, found = _words(printed), _words(output)
    for k, (one, other) in enumerate(zip(expected, found)):
        if not _agree(one, other):
            near = " ".join(expected[max(k - 6, 0) : k])
            return f"after '{near}': the page prints '{one}', now it is '{other}'"
    if len(expected) != len(found):
        return f"the page prints {len(expected)} words, now there are {len(found)}"
    return None


def _words(text: str) -> list[str]:
    return re.sub("─+", "─", text).split()


def _agree(one: str, other: str) -> bool:
    if NUMBER.sub("#", one) != NUMBER.sub("#", other):
        return False
    pairs = zip(NUMBER.findall(one), NUMBER.findall(other))
    return all(_close(*pair) for pair in pairs)


def _close(one: str, other: str) -> bool:
    if "." not in one + other and "e" not in one + other:
        return abs(int(one) - int(other)) <= COUNTED * abs(int(one))
    if max(abs(float(one)), abs(float(other))) < ZERO:
        return True
    decimals = len(one.partition("e")[0].partition(".")[2])
    exponent = int(one.partition("e")[2] or 0)
    allowed = max(RELATIVE * abs(float(one)), LAST_DIGITS * 10.0 ** (exponent - decimals))
    return abs(float(one) - float(other)) <= allowed * (1 + 1e-9)


def write(page: Path) -> None:
    """The page with the present outputs."""
    with TemporaryDirectory() as place:
        folder = Path(place) / "work"
        folder.mkdir()

        def renewed(found: re.Match) -> str:
            output = shortened(run(Block(found[1], found[2], ""), folder))
            code = f"```{found[1]}\n{found[2]}```\n"
            return code + (f"\n```text\n{output}\n```\n" if output else "")

        text = BLOCK.sub(renewed, page.read_text(encoding="utf-8"))
    page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    for name in sys.argv[1:] or sorted(page.stem for page in TUTORIALS.glob("*.md")):
        print(name, flush=True)
        write(TUTORIALS / f"{name}.md")
