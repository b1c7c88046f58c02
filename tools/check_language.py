"""Words that this project no longer uses, and the term of the field that replaces each.

`python tools/check_language.py` prints every occurrence in code, tests and documents; exit status 1 if there is
one. Arguments limit the check to files and folders. The glossary (docs/glossary.md) lists the terms to use. A word is
found in prose and in every part of a name (`is_told`, `ToldBy`, `told_2`), a phrase also where an underscore, a hyphen
or the end of a line divides it. Markdown pages avoid more words (`PAGE_WORDS`), except in their code. Keys of JSON and
CSV files, names of suites, paths and command-line options are contracts; `CONTRACTS` lists where they contain such a
word.
"""

import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = (
    "workbench",
    "sensors",
    "robot_model",
    "datasets",
    "tools",
    "benchmarks",
    "docs",
    "tests",
)
PAGES = ("README.md", "CHANGELOG.md", "Makefile", "pyproject.toml", "mkdocs.yml")
SUFFIXES = {".py", ".md", ".toml", ".j2", ".html", ".js", ".css", ".yml", ".yaml", ".txt"}
SKIPPED = {"check_language.py", "test_language.py", "glossary.md"}
# The text behind a pattern is the term to use. A space stands for any gap between two words of a phrase.
WORDS = {
    r"tell(s|ing)? ([\w-]+ ){0,3}apart|told ([\w-]+ ){0,3}apart": "distinguish, distinguishable",
    r"cannot be told|told from|tells? (it|them|one|\w+-\w+) from": "confounded, not distinguishable",
    r"un?told|told": "stated, given, known",
    r"anew": "again",
    r"twins?": "confounded effect; simulated scanner, cell",
    r"rival(s|led|ling)?": "alternative explanation",
    r"one and the same here": "confounded, only a combination is identifiable",
    r"left open": "not identifiable",
    r"what the model (leaves out|lacks)|what (was|is) left out": "unmodelled effect",
    r"earn(s|ed)? (its|their) places?|not earned": "retained by cross-validation",
    r"wander(s|ed|ing)?": "drift",
    r"yields|yielding|yielded|yield (to|under)": "compliance, deflects under load",
    r"with (its|their) masses found": "with first mass moments estimated jointly",
    r"(once|twice|times|cycles) a turn": "cycles per revolution",
    r"(has|have|having|with|of|without|no) play|play (of|in|at) (a|the|its|joint)": "backlash",
    r"standstills?": "static pose",
    r"unsure(ness)?": "uncertain",
    r"pictur(e|es|ed|ing)": "image",
    r"crowding": "design effect",
    r"uneven noise": "heteroscedastic noise",
    r"moves? by chance": "random effect",
    r"scrambl(e|ed|es|ing)": "permutation control, circular-shift control",
    r"(clock|time) moved round": "circular-shift control",
    r"found again in": "reselected in",
    r"swallow(s|ed|ing)?": "absorb",
    r"smallest visible size": "minimal detectable bias",
    r"(functions?|laws?|effects?|physics) without a name|unnamed (rivals?|functions?)": "smooth nonparametric function",
    r"moves? at random": "random effect, varies at random",
    r"figures? to trust": "estimate of the prediction error",
    r"conceal(s|ed|ing|ment)?": "planted, blinded",
    r"(un)?sealed": "hash-committed, unblinded",
    r"examinations?": "benchmark run",
    r"blind proofs?": "blind benchmark",
    r"(laser|laser's|light|its|bowed) sheets?|sheets? of light": "light plane",
    r"(stripe|stripe's) (own )?courses?|course of (a|the|its) (own )?stripe": "stripe centreline",
    r"left by the inversion|what the inversion leaves": "inverse-kinematics residual",
    r"what stands still": "scatter of the estimated board pose",
    r"the one rigid motion": "after rigid alignment",
    r"in the making": "work in progress",
    r"mend(s|ed|ing)?": "fix",
    r"beside": "next to, conditional on",
    r"(of|every|each|a|the|several|some|two|three|all) placements?|placements? of (a|the) boards?": "board pose",
    r"nod(s|ded|ding)?": "tilt about the horizontal axis",
    r"sheets? (planes?|normals?)|(fan|plane) of light sheets?": "light plane",
    r"abstain(s|ed|ing)?|abstention": "unexplained, reports no cause",
    r"surviv(e|es|ed|ing) (of )?(a|an|the|its|their) ([\w-]+ )?(baseline|fit)": "orthogonal to the baseline",
    r"surviving (size|signature|part|share)s?|what survives": "part orthogonal to the baseline",
}
# Words that pages of the documentation do not use; in code they have other senses.
PAGE_WORDS = {
    r"(?<!in\s)turn(s|ed|ing)?(?! (on|off|into|out)\b)": "rotate, rotation, revolution",
    r"(stay|stays|leave|leaves) (\w+ )?open": "not identifiable, uncertain",
    r"what (is|was|are) left|what (it|they|he|she) leaves?": "residual, remainder",
    r"cannot tell|tells? which": "not identifiable, states which",
    r"stand(s)? ([\w.]+ ){0,3}apart|σ apart": "differ by",
    r"by itself|by themselves": "alone, separately",
    r"all the same(?! )": "nevertheless",
    r"whoever|anybody|nobody|somebody": "the user, every user, no one",
    r"likelier|likeliest": "more probable",
    r"more than luck|by luck|beyond luck": "significantly",
}
# Pages whose lines are data of a finished run, as they were written then.
RECORDED_PAGES = {"scoreboard.md"}
# Keys, suites, paths and options that other programs and files rely on; they are not prose.
CONTRACTS = (
    r"""(["'`])(concealed|sealed|swallowed|twins?|twin_where|t_searched_anew|told|pictures?|abstained|nod)\1""",
    r"\bsealed/",
    r"\bswallowed(?==\d)",
    r"\bconcealed(?==\[)",
    r"\| swallowed(?= \|)",
    r"(default: |--|--no-)pictures|from[-_]pictures",
    r"\b(calib|light)_picture\b",
    r"(?<=\|)picture(?=\|foto\|)",  # a column name that importers accept
    r"^\| `[0-9a-f]{12}` .*",  # a case of the scoreboard: claims as they were written
    r"(?<=\| )abstained(?= \|)",  # outcome of a case
    r"""\"(add a|every step of a) placement( once)?\"""",  # messages that name the column
    r"context manager that yields|the yielded list",  # what Python calls the value of a generator
)
# Between two words of a phrase: blanks, underscores or hyphens, and the end of a line of a text, string or comment.
GAP = r"""(?:[\s_-]|(?<=["'])\n|["'](?=\s*\n)|(?<=\s)(?:\#|[rf]?["']))+"""
# A name in camel case starts a word with a capital after a small letter.
START = r"(?:(?<![A-Za-z])|(?<=(?-i:[a-z]))(?=(?-i:[A-Z])))"
END = r"(?!(?-i:[a-z])|(?<=(?-i:[A-Z]))(?-i:[A-Z]))"


def pattern_of(words: Mapping[str, str]) -> re.Pattern:
    """One expression for all words, with a group `w0`, `w1`, ... each."""
    groups = []
    for number, word in enumerate(words):
        without_groups = re.sub(r"[(](?![?])", "(?:", word)
        groups.append(f"(?P<w{number}>{without_groups.replace(' ', GAP)})")
    return re.compile(f"{START}(?:{'|'.join(groups)}){END}", re.IGNORECASE)


def blanked(text: str) -> str:
    """The text with its contracts replaced by as many blanks, so that line numbers stay."""
    contracts = re.compile("|".join(f"(?:{one})" for one in CONTRACTS), re.MULTILINE)
    return contracts.sub(lambda match: " " * len(match.group()), text)


def prose_of(page: str) -> str:
    """A page in Markdown without its code, which is replaced by as many blanks and line ends."""
    code = re.compile(r"^```.*?^```|`[^`\n]+`", re.MULTILINE | re.DOTALL)
    return code.sub(lambda match: re.sub(r"[^\n]", " ", match.group()), page)


def find_in(
    text: str, words: Mapping[str, str] = MappingProxyType(WORDS)
) -> Iterator[tuple[int, str, str]]:
    """(line number, word, replacement) of every occurrence in a text."""
    terms = list(words.values())
    for match in pattern_of(words).finditer(blanked(text)):
        line = text.count("\n", 0, match.start()) + 1
        yield line, " ".join(match.group().split()), terms[int(match.lastgroup[1:])]


def find_faults(paths: Iterator[Path]) -> Iterator[tuple[Path, int, str, str]]:
    """(path, line number, word, replacement) of every occurrence; line 0 is the name of the file."""
    for path in paths:
        for _, word, term in find_in(path.stem):
            yield path, 0, word, term
        text = path.read_text(encoding="utf-8")
        for line, word, term in find_in(text):
            yield path, line, word, term
        if path.suffix == ".md" and path.name not in RECORDED_PAGES:
            for line, word, term in find_in(prose_of(text), PAGE_WORDS):
                yield path, line, word, term


def list_texts(root: Path, wanted: list[str]) -> Iterator[Path]:
    """Files of code and documents; wanted: files or folders relative to `root`, all if empty."""
    for name in wanted or (*PAGES, *FOLDERS):
        place = root / name
        for path in [place] if place.is_file() else sorted(place.rglob("*")):
            is_text = path.suffix in SUFFIXES or path.name in PAGES
            if path.is_file() and is_text and path.name not in SKIPPED:
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
