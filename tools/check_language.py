"""Words that this project no longer uses, and the term of the field that replaces each.

`python tools/check_language.py` prints every line of code and documents that contains such a word; exit
status 1 if there is one. Arguments limit the check to files and folders. The glossary
(docs/glossary.md) lists the terms to use. Keys of JSON and CSV files, names of suites, paths and
command-line options are contracts; `CONTRACTS` lists where they contain such a word.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("workbench", "sensors", "robot_model", "datasets", "tools", "benchmarks", "docs")
PAGES = ("README.md",)
SUFFIXES = {".py", ".md", ".toml", ".j2"}
SKIPPED = {"check_language.py", "glossary.md"}
# Each pattern matches in prose and in parts of names (`is_told`); the text behind it is the term to use.
WORDS = {
    r"tell(s|ing)? apart|told apart": "distinguish, distinguishable",
    r"cannot be told|told from": "confounded, not distinguishable",
    r"told|untold": "stated, given, known",
    r"anew": "again",
    r"twins?": "confounded effect",
    r"rivals?": "alternative explanation",
    r"one and the same here": "confounded, only a combination is identifiable",
    r"left open": "not identifiable",
    r"what the model (leaves out|lacks)|what (was|is) left out": "unmodelled effect",
    r"earn(s|ed)? (its|their) places?|not earned": "retained by cross-validation",
    r"wander(s|ed|ing)?": "drift",
    r"what yields|it yields|(arm|joint|link)s? that yields?|yield(s|ed)? to": "compliance, deflects under load",
    r"with (its|their) masses found": "with first mass moments estimated jointly",
    r"(once|twice|times|cycles) a turn": "cycles per revolution",
    r"(has|have|with|of) play": "backlash",
    r"standstills?": "static pose",
    r"unsure": "uncertain",
    r"pictures?": "image",
    r"crowding": "design effect",
    r"uneven noise": "heteroscedastic noise",
    r"moves? by chance": "random effect",
    r"scrambl(e|ed|es|ing)": "permutation control, circular-shift control",
    r"(clock|time) moved round": "circular-shift control",
    r"found again in": "reselected in",
    r"swallow(s|ed|ing)?": "absorb",
    r"smallest visible size": "minimal detectable bias",
    r"(function|law|effect|physics) without a name|unnamed rivals?": "smooth nonparametric alternative",
    r"conceal(s|ed|ing)?": "planted, blinded",
    r"sealed": "hash-committed",
    r"(the|an|this|blind) examination": "benchmark run",
    r"blind proof": "blind benchmark",
    r"(laser|laser's) sheets?|sheets? of light": "light plane",
    r"left by the inversion|what the inversion leaves": "inverse-kinematics residual",
    r"what stands still": "scatter of the estimated board pose",
    r"the one rigid motion": "after rigid alignment",
    r"in the making": "work in progress",
    r"mend(s|ed)": "fix",
    r"beside": "next to, conditional on",
}
# Keys, suites, paths and options that other programs and files rely on; they are not prose.
CONTRACTS = (
    r"""(["'`])(concealed|sealed|swallowed|twins?|twin_where|t_searched_anew|told|pictures?)\1""",
    r"\bsealed/",
    r"\bswallowed(?==\d)",
    r"\| swallowed(?= \|)",
    r"(default: |--|--no-)pictures|from[-_]pictures",
    r"\b(calib|light)_picture\b",
    r"(?<=\|)picture(?=\|foto\|)",  # a column name that importers accept
    r"^\| `[0-9a-f]{12}` .*",  # a case of the scoreboard: claims as they were written
)


def find_faults(paths: Iterator[Path]) -> Iterator[tuple[Path, int, str, str]]:
    """(path, line number, word, replacement) of every occurrence."""
    contracts = re.compile("|".join(f"(?:{one})" for one in CONTRACTS))
    terms = list(WORDS.values())
    groups = "|".join(f"(?P<w{i}>{re.sub(r'[(](?![?])', '(?:', w)})" for i, w in enumerate(WORDS))
    pattern = re.compile(rf"(?<![A-Za-z])(?:{groups})(?![A-Za-z])", re.IGNORECASE)
    for path in paths:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            for match in pattern.finditer(contracts.sub("", line)):
                yield path, number, match.group(), terms[int(match.lastgroup[1:])]


def list_texts(root: Path, wanted: list[str]) -> Iterator[Path]:
    """Files of code and documents; wanted: files or folders relative to `root`, all if empty."""
    for name in wanted or (*PAGES, *FOLDERS):
        place = root / name
        for path in [place] if place.is_file() else sorted(place.rglob("*")):
            if path.suffix in SUFFIXES and path.name not in SKIPPED:
                yield path


def main() -> int:
    """Print every fault; their number decides the exit status."""
    found = list(find_faults(list_texts(ROOT, sys.argv[1:])))
    for path, number, word, term in found:
        print(f"{path.relative_to(ROOT)}:{number}: '{word}': write {term}")
    print(f"{len(found)} words that are not in use any more")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
