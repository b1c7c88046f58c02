"""Writes docs/reference/commands.md from the command line: its help, by typer, below an image of the terminal.

`python tools/commands_page.py [FILE]`; a part of `make docs`. The page is kept in the repository.
"""

import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "commands.md"
IMAGE = "![The commands of the workbench](../images/commands.svg)"
EXAMPLE = re.compile(r"^Example: (.+)$", re.MULTILINE)
WORDS = ["workbench.commands.cli", "utils", "docs", "--name", "workbench", "--output"]


def page() -> str:
    """The page as Markdown. Raises CalledProcessError if typer fails."""
    with TemporaryDirectory() as folder:
        made = Path(folder) / "commands.md"
        subprocess.run([sys.executable, "-m", "typer", *WORDS, str(made)], check=True)
        title, rest = made.read_text(encoding="utf-8").split("\n\n", 1)
    rest = EXAMPLE.sub(r"**Example**:\n\n```console\n$ \1\n```", rest)
    return f"{title}\n\n{IMAGE}\n\n{rest}"


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else PAGE
    target.write_text(page(), encoding="utf-8")
    print(f"{target.name} written")
