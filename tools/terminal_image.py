"""Images of a terminal: commands are run, and what they print is drawn as SVG."""

import io
import os
import re
import stat
import subprocess
import sys
from pathlib import Path

from rich.console import Console
from rich.terminal_theme import TerminalTheme
from rich.text import Text

ROOT = Path(__file__).resolve().parents[1]
COLUMNS = 96
PROMPT = "$ "
THEME = TerminalTheme(
    (250, 250, 250),
    (38, 50, 56),
    [(38, 50, 56), (183, 28, 28), (27, 94, 32), (138, 90, 0)]
    + [(21, 101, 192), (106, 27, 154), (0, 96, 100), (96, 110, 116)],
)
# The page of rich without its fonts from the network: the site is viewed without one.
SVG = """<svg viewBox="0 0 {terminal_width} {terminal_height}" xmlns="http://www.w3.org/2000/svg" role="img">
<style>
.{unique_id}-matrix {{ font-family: "DejaVu Sans Mono", Menlo, Consolas, monospace;
 font-size: {char_height}px; line-height: {line_height}px; }}
{styles}
</style>
<defs>
{lines}
</defs>
<rect width="{terminal_width}" height="{terminal_height}" rx="8" fill="#fafafa" stroke="#b0bec5"/>
<g transform="translate(10, 8)">
{backgrounds}
<g class="{unique_id}-matrix">
{matrix}
</g>
</g>
</svg>
"""


def run(command: str, folder: Path) -> subprocess.CompletedProcess:
    """The command in a shell in which `workbench` is that of this checkout."""
    tools = link_tools(folder / ".bin")
    environment = {
        **os.environ,
        "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "COLUMNS": str(COLUMNS),
    }
    words = ["bash", "-c", command]
    return subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)


def link_tools(folder: Path) -> Path:
    """`folder`, with the commands `workbench` and `python3` of this checkout."""
    if not folder.exists():
        folder.mkdir()
        _link(folder / "workbench", f'"{sys.executable}" -m workbench')
        _link(folder / "python3", f'"{sys.executable}"')
    return folder


def _link(path: Path, program: str) -> None:
    path.write_text(f'#!/bin/sh\nexec {program} "$@"\n', encoding="utf-8")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


def draw(name: str, text: str) -> str:
    """SVG of text; commands are bold."""
    console = Console(record=True, width=COLUMNS + 2, file=io.StringIO())
    for line in [*text.splitlines(), ""]:
        style = "bold" if line.startswith(PROMPT) else ""
        console.print(Text(line, style=style), overflow="fold", highlight=False, width=COLUMNS)
    image = console.export_svg(theme=THEME, code_format=SVG, unique_id=name)
    return re.sub(r"[ \t]+\n", "\n", image)
