"""No effect of the catalogues is named in product code outside its own class: effects describe themselves.

Run from anywhere: `python tools/check_names.py [ROOT]`. Prints one line a fault, then a summary; exit status 1
where there is a fault. Code that needs a certain effect refers to its class (`JointCompliance.effect`), and code that
needs a kind of effect asks for a member (`mass_dependent`, `reads`, `of_session`, ...).

Names of one word ("backlash") are ordinary words as well, which no text search distinguishes; they are not checked.

No function, class, parameter, field or variable is called by a preposition, an adverb or a word that the terms of the
field replace (`NO_NAMES`). Folders that still have such names have a ceiling (`MOST_NAMES`), which is only lowered.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from robot_model.effects import CATALOGUE as ROBOT
from sensors.effects import CATALOGUE as SENSOR

PACKAGES = ("workbench", "sensors", "robot_model", "datasets")
ALLOWED = {
    "datasets/makers/": "independent simulators that import no model state their truth in these words",
    "workbench/commands/robot/diagnose.py": "a value of the option --baseline; commands import no numerics",
}
"""Start of a path -> the reason why names may stand there."""
NO_NAMES = frozenset(
    "about above across again alike along also among against apart around aside at away back behind below between "
    "beyond both brings doubt doubts each elsewhere every far few forward held here inside instead judged judges "
    "lacking least less lit loose mine more most much near off on once one otherwise ours outside over own parts rest "
    "said say seems sets some spent still theirs there to together towards twice under very visible what "
    "when which whole within without".split()
)
"""Words that are no name by themselves, whatever underscores or capitals surround them."""
KEPT = ("of", "at")
"""Methods that construct (`Parameters.of`) and that select samples (`Model.at`): one meaning in the whole project."""
MOST_NAMES = {"workbench": 20, "sensors": 7, "robot_model": 1, "datasets": 0}
"""Number of names in each package that still are such a word."""


def main(root: Path) -> int:
    """Check every product file under `root`; the number of faults."""
    names = {word for word in effect_names() if "-" in word}
    faults = []
    for folder in PACKAGES:
        for path in sorted((root / folder).rglob("*.py")):
            inside = path.relative_to(root).as_posix()
            if not inside.startswith(tuple(ALLOWED)):
                faults += file_faults(inside, ast.parse(path.read_text(encoding="utf-8")), names)
    for folder, most in MOST_NAMES.items():
        found = list(name_faults(root, folder))
        if len(found) > most:
            faults += [*found, f"{folder}: {len(found)} such names, expected at most {most}"]
        print(f"{folder}: {len(found)} names that are no noun or verb, at most {most}")
    for fault in faults:
        print(fault)
    print(f"{len(names)} effect names, {len(faults)} faults")
    return len(faults)


def effect_names() -> set[str]:
    """Keys of the catalogues and words of the vocabulary."""
    return {word for table in (ROBOT, SENSOR) for key in table for word in (key, table[key].effect)}


def file_faults(path: str, tree: ast.Module, names: set[str]) -> Iterator[str]:
    """One line for each literal with a name of an effect, but for docstrings, the class itself and the catalogue."""
    excused = {id(node) for part in excused_parts(path, tree, names) for node in ast.walk(part)}
    pattern = re.compile(r"(?<![\w-])(" + "|".join(map(re.escape, sorted(names))) + r")(?![\w-])")
    for node in ast.walk(tree):
        is_text = isinstance(node, ast.Constant) and isinstance(node.value, str)
        found = pattern.search(node.value) if is_text and id(node) not in excused else None
        if found:
            yield f"{path}:{node.lineno}: names the effect '{found[1]}'; refer to its class or a member"


def excused_parts(path: str, tree: ast.Module, names: set[str]) -> Iterator[ast.AST]:
    """Parts of a file in which names may stand: docstrings, classes of effects, the dictionary CATALOGUE."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and effect_of(node) in names:
            yield node
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            yield node
        if path.endswith("/effects/__init__.py") and isinstance(node, ast.Assign):
            yield node


def effect_of(node: ast.ClassDef) -> str | None:
    """The text that a class assigns to `effect`."""
    for line in node.body:
        if isinstance(line, ast.Assign) and isinstance(line.value, ast.Constant):
            if [ast.unparse(target) for target in line.targets] == ["effect"]:
                return line.value.value
    return None


def name_faults(root: Path, folder: str) -> Iterator[str]:
    """One line for each name in a package that is a word of `NO_NAMES`."""
    for path in sorted((root / folder).rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for line, name in sorted(set(defined_names(tree))):
            if name.strip("_").lower() in NO_NAMES:
                place = f"{path.relative_to(root).as_posix()}:{line}"
                yield f"{place}: '{name}' is no noun or verb; use a term of the field"


def defined_names(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """(line, name) of all functions, classes, parameters, fields and variables."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            if node.name not in KEPT:
                yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id


if __name__ == "__main__":
    where = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent.parent
    sys.exit(1 if main(where) else 0)
