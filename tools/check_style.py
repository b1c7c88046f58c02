"""House style, checked: short functions, short files, flat classes, docstrings, no machine paths.

Run from anywhere: `python tools/check_style.py [ROOT]`. Prints one line a fault, then a summary;
exit status 1 where there is a fault. A function's length is that of its body without docstring.
"""

import ast
import os
import re
import statistics
import sys
from collections.abc import Iterator
from pathlib import Path

PACKAGES = ("workbench", "sensors", "robot_model", "datasets")
CODE = (*PACKAGES, "tools", "tests", "benchmarks")
LONGEST_FUNCTION = 50
MEDIAN_BELOW = 12
LONGEST_FILE = 500
# Tables of cases make tests long without making them hard to read.
LONGEST_TEST_FILE = 800
DEEPEST_CLASS = 1
# Folders -> ceilings of the density of code: nodes of the syntax tree in a line of a function's body, and the median
# number of nodes in a function's body. They are only lowered.
DENSITY = {"": (12.05, 46), "workbench/diagnosis": (13.3, 47)}
# Packages whose docstrings say what a thing is or does: none begins with "What".
WITHOUT_WHAT = ("robot_model", "workbench/core")
TEXTS = {".py", ".toml", ".md", ".csv", ".j2", ".sh", ".yml", ".yaml", ".cfg", ""}
SKIPPED = {".git", "runs", "build", "dist", "site", "shared", "node_modules", "__pycache__"}
# A folder of some machine at the start of a path, and not inside an address or a longer path.
MACHINE_PATH = re.compile(r"(?<![\w.~/-])/(?:work|tmp|root|home|Users)(?:/|\b(?=[\"'\s]|$))")

Function = ast.FunctionDef | ast.AsyncFunctionDef


def main(root: Path) -> int:
    """Check everything under `root`; the number of faults."""
    sources = {path: ast.parse(path.read_text(encoding="utf-8")) for path in code_files(root)}
    faults = [fault for path, tree in sources.items() for fault in file_faults(path, tree)]
    faults += class_faults(sources)
    for path, tree in sources.items():
        if path.relative_to(root).as_posix().startswith(WITHOUT_WHAT):
            faults += docstring_faults(path, tree)
    faults += [fault for path in text_files(root) for fault in path_faults(path)]
    median = median_length(root, sources)
    if median >= MEDIAN_BELOW:
        faults.append(f"{root}: median function body {median:g} lines, expected < {MEDIAN_BELOW}")
    for folder, ceilings in DENSITY.items():
        faults += density_faults(folder, ceilings, density(root, sources, folder))
    for fault in faults:
        print(fault)
    print(f"{len(sources)} files, median function {median:g} lines, {len(faults)} faults")
    return len(faults)


def code_files(root: Path) -> list[Path]:
    """Every Python file of ours."""
    return sorted(
        path
        for folder in CODE
        for path in (root / folder).rglob("*.py")
        if not SKIPPED & set(path.relative_to(root).parts)
    )


def text_files(root: Path) -> Iterator[Path]:
    """Every text file of the project, whatever its language."""
    for folder, folders, files in os.walk(root):
        folders[:] = sorted(name for name in folders if not _is_hidden(name))  # not walked at all
        for name in sorted(set(files) - SKIPPED):  # a linked worktree has a file .git
            path = Path(folder) / name
            if path.suffix in TEXTS and path.is_file():
                yield path


def _is_hidden(folder: str) -> bool:
    """Whether a folder holds what a tool has made."""
    is_made = folder in SKIPPED or folder == ".hypothesis" or folder.startswith(".venv")
    return is_made or folder.endswith(("cache", "info"))


def file_faults(path: Path, tree: ast.Module) -> Iterator[str]:
    """Missing docstring, too many lines, functions too long."""
    length = len(path.read_text(encoding="utf-8").splitlines())
    if not ast.get_docstring(tree):
        yield f"{path}:1: no docstring that says what the file is for"
    longest = LONGEST_TEST_FILE if path.name.startswith("test_") else LONGEST_FILE
    if length > longest:
        yield f"{path}:1: {length} lines, expected < {longest + 1}"
    for function in functions(tree):
        if body_length(function) > LONGEST_FUNCTION:
            yield (
                f"{path}:{function.lineno}: {function.name} has {body_length(function)} lines, "
                f"expected <= {LONGEST_FUNCTION}"
            )


def docstring_faults(path: Path, tree: ast.Module) -> Iterator[str]:
    """Docstrings that begin with a clause ("What a solve returns") instead of a noun or a verb."""
    documented = ast.Module | ast.ClassDef | Function
    for node in ast.walk(tree):
        text = ast.get_docstring(node) if isinstance(node, documented) else None
        if text and text.startswith("What "):
            line = getattr(node, "lineno", 1)
            yield f"{path}:{line}: docstring begins with 'What'; say what it is or does"


def functions(tree: ast.AST) -> list[Function]:
    """Every function and method in `tree`, the inner ones too."""
    return [node for node in ast.walk(tree) if isinstance(node, Function)]


def body_length(function: Function) -> int:
    """Lines from the first statement after the docstring to the last."""
    body = function.body[1:] if ast.get_docstring(function) else function.body
    return body[-1].end_lineno - body[0].lineno + 1 if body else 0


def median_length(root: Path, sources: dict[Path, ast.Module]) -> float:
    """Median body length over the packages, tests and tools left aside."""
    lengths = [
        body_length(function)
        for path, tree in sources.items()
        if path.relative_to(root).parts[0] in PACKAGES
        for function in functions(tree)
    ]
    return statistics.median(lengths) if lengths else 0.0


def density(root: Path, sources: dict[Path, ast.Module], folder: str) -> tuple[float, float]:
    """Nodes of the syntax tree in a line of code, and the median number of nodes in the body of a function.

    Of all functions of the packages below `folder`. A line of code is neither blank nor a comment nor of a docstring;
    the marks of loading and storing a name are no nodes of a function here.
    """
    nodes, lines, sizes = 0, 0, []
    for path, tree in sources.items():
        inside = path.relative_to(root).as_posix()
        if not inside.startswith(
            tuple(f"{package}/" for package in PACKAGES)
        ) or not inside.startswith(folder):
            continue
        is_code = code_lines(path.read_text(encoding="utf-8").splitlines(), tree)
        for function in functions(tree):
            body = function.body[1:] if ast.get_docstring(function) else function.body
            if body:
                of_body = [node for statement in body for node in ast.walk(statement)]
                nodes += len(of_body)
                lines += sum(is_code[body[0].lineno - 1 : body[-1].end_lineno])
                sizes.append(sum(not isinstance(node, ast.expr_context) for node in of_body))
    return (nodes / max(lines, 1), statistics.median(sizes)) if sizes else (0.0, 0.0)


def code_lines(lines: list[str], tree: ast.Module) -> list[bool]:
    """For each line whether it is code: not blank, no comment, not of a docstring."""
    is_code = [bool(line.strip()) and not line.lstrip().startswith("#") for line in lines]
    for node in ast.walk(tree):
        is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if is_text and isinstance(node.value.value, str):
            is_code[node.lineno - 1 : node.end_lineno] = [False] * (
                node.end_lineno - node.lineno + 1
            )
    return is_code


def density_faults(
    folder: str, ceilings: tuple[float, float], found: tuple[float, float]
) -> Iterator[str]:
    """Print the density of a folder; a line for each figure above its ceiling."""
    name = folder or "all packages"
    print(f"{name}: {found[0]:.2f} nodes a line, median function {found[1]:g} nodes")
    for value, ceiling, unit in zip(
        found, ceilings, ("nodes a line", "nodes in the median function")
    ):
        if value > ceiling:
            yield f"{name}: {value:.2f} {unit}, expected at most {ceiling:g}"


def class_faults(sources: dict[Path, ast.Module]) -> Iterator[str]:
    """Classes of ours that stand more than one step below another class of ours."""
    classes = {
        node.name: (path, node)
        for path, tree in sources.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
    }
    for name, (path, node) in classes.items():
        depth = class_depth(name, classes)
        if depth > DEEPEST_CLASS:
            yield (
                f"{path}:{node.lineno}: class {name} stands {depth} steps below its first "
                f"ancestor, expected <= {DEEPEST_CLASS}"
            )


def class_depth(name: str, classes: dict, above: frozenset[str] = frozenset()) -> int:
    """Steps from class `name` up to its farthest ancestor among `classes`."""
    _, node = classes[name]
    bases = {ast.unparse(base).split("[")[0].split(".")[-1] for base in node.bases}
    ours = (bases & classes.keys()) - above - {name}
    return max((1 + class_depth(base, classes, above | {name}) for base in ours), default=0)


def path_faults(path: Path) -> Iterator[str]:
    """Lines that name a folder of some machine."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError:
        return
    for number, line in enumerate(lines, start=1):
        found = MACHINE_PATH.search(line)
        if found:
            yield f"{path}:{number}: names a path of one machine, '{found.group()}'"


if __name__ == "__main__":
    where = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent.parent
    sys.exit(1 if main(where) else 0)
