"""Integrity checks of a benchmark run: independent case generators, unchanged truths, version of the program."""

import ast
import hashlib
import shutil
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

from workbench.core.errors import InputError
from workbench.proving import protocol
from workbench.proving.figures import Figure, rate

_PROGRAM = (
    "workbench/core",
    "workbench/diagnosis",
    "workbench/explanation",
    "robot_model",
    "sensors",
    "datasets",
)
_CHECKED_PACKAGES = ("robot_model", "sensors", "workbench")


@lru_cache(maxsize=1)
def program() -> str:
    """Checksum of the source files of the diagnosis. It marks answers of different versions of the program.

    Computed once per process, because a process keeps the code that it has loaded.
    """
    checksum = hashlib.sha256()
    for place in _PROGRAM:
        for path in sorted((protocol.PROJECT / place).rglob("*.py")):
            if "makers" not in path.parts:
                checksum.update(
                    path.relative_to(protocol.PROJECT).as_posix().encode() + path.read_bytes()
                )
    return checksum.hexdigest()[:12]


def checks(exam: protocol.BenchmarkRun, rows: Sequence[Mapping]) -> list[Figure]:
    """The figures on independence and integrity, counted from the present files."""
    makers = maker_files()
    seals = protocol.published(exam)
    names = [row["case"] for row in rows]
    return [
        rate(
            "independence",
            "modules of the makers that import nothing of the model",
            makers,
            lambda path: not _forbidden_imports(path),
            "all",
            1.0,
        ),
        rate(
            "honesty",
            "committed truths in which one changed byte fails the run",
            names,
            _tamper_test(exam, seals),
            "all",
            1.0,
        ),
        rate(
            "honesty",
            "diagnoses that opened nothing but their recording",
            rows,
            lambda r: not r.get("opened"),
            "all",
            1.0,
        ),
    ]


def maker_files() -> list[Path]:
    """Source files of the generators of blind cases, and of all modules of `datasets` that they import."""
    found = [
        path
        for place in protocol.MAKERS
        for path in ([place] if place.is_file() else place.glob("*.py"))
    ]
    for path in found:  # the list grows during the loop
        imported = (_file(name) for name in _imported(path) if name.startswith("datasets."))
        found += [other for other in imported if other is not None and other not in found]
    return sorted(set(found))


def _imported(path: Path) -> Iterator[str]:
    """Dotted names of all modules that a file imports, including names imported from a package."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (imported.name for imported in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{imported.name}" for imported in node.names)


def _file(name: str) -> Path | None:
    path = protocol.PROJECT.joinpath(*name.split(".")).with_suffix(".py")
    return path if path.is_file() else None


def _forbidden_imports(path: Path) -> list[str]:
    return [name for name in _imported(path) if name.split(".")[0] in _CHECKED_PACKAGES]


def _tamper_test(exam: protocol.BenchmarkRun, seals: Mapping[str, str]):
    """A predicate over case names: true if a copy of the truth with one changed byte is rejected."""

    def refused(name: str) -> bool:
        with TemporaryDirectory() as place:
            copy = protocol.BenchmarkRun(Path(place))
            copy.truth(name).parent.mkdir()
            shutil.copyfile(exam.truth(name), copy.truth(name))
            protocol.check(copy, {name: seals[name]})
            text = bytearray(copy.truth(name).read_bytes())
            text[len(text) // 2] ^= 1
            copy.truth(name).write_bytes(text)
            return _fails(copy, name, seals)

    return refused


def _fails(exam, name, seals) -> bool:
    try:
        protocol.check(exam, {name: seals[name]})
    except InputError:
        return True
    return False
