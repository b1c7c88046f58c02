"""Words that this project no longer uses, and the term of the field that replaces each.

`python tools/check_language.py` prints every line of code and documents that holds such a word; exit
status 1 if there is one. The glossary (docs/glossary.md) lists the terms to use.
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("workbench", "sensors", "robot_model", "datasets", "tools", "benchmarks", "docs")
PAGES = ("README.md",)
SUFFIXES = {".py", ".md", ".toml", ".j2"}
# Each pattern matches prose and names in code alike; the text behind it is the term to use instead.
WORDS = {
    r"\btold apart\b": "distinguishable",
    r"\btell apart\b": "distinguish",
    r"\banew\b": "again",
    r"\btwins?\b(?! of the| digital)": "confounded effect",
    r"\brivals?\b": "alternative explanation",
    r"\bearned its place\b": "retained by cross-validation",
    r"\bwanders?\b": "drifts",
    r"\bwhat yields\b": "compliance",
    r"\bit yields\b": "deflects under load",
    r"\bstandstills?\b": "static pose",
    r"\bunsure\b": "uncertain",
    r"\bpictures?\b": "image",
    r"\bcrowding\b": "design effect",
    r"\buneven noise\b": "heteroscedastic noise",
    r"\bswallow(s|ed)?\b": "absorb",
    r"\bmends?\b|\bmended\b": "fix",
    r"\bwithout a name\b": "unnamed, nonparametric",
    r"\bconcealed\b": "blinded",
    r"\bsealed\b": "hash-committed",
    r"\bbeside\b": "next to; conditional on",
    r"\btold\b": "stated",
}


def faults(root: Path):
    """(path, line number, word, replacement) of every occurrence."""
    pattern = re.compile(
        "|".join(f"(?P<w{i}>{word})" for i, word in enumerate(WORDS)), re.IGNORECASE
    )
    terms = list(WORDS.values())
    for path in texts(root):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            for match in pattern.finditer(line):
                yield path, number, match.group(), terms[int(match.lastgroup[1:])]


def texts(root: Path):
    """Files of code and documents."""
    yield from (root / page for page in PAGES)
    for folder in FOLDERS:
        for path in sorted((root / folder).rglob("*")):
            if path.suffix in SUFFIXES and path.name not in ("check_language.py", "glossary.md"):
                yield path


def main() -> int:
    """Print every fault; their number decides the exit status."""
    found = list(faults(ROOT))
    for path, number, word, term in found:
        print(f"{path.relative_to(ROOT)}:{number}: '{word}': write {term}")
    print(f"{len(found)} words that are not in use any more")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
