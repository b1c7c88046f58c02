"""Writes workbench/__init__.pyi: public names with signatures and docstrings, for editors, type checkers and the docs.

`workbench` imports its names at their first use, which no tool sees that reads the source alone. `--check` compares.
"""

import inspect
import subprocess
import sys
from pathlib import Path

import workbench
from workbench.api.functions import COMMANDS

STUB = Path(workbench.__file__).with_suffix(".pyi")
HEAD = '''"""{docstring}"""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from numpy import ndarray
from pandas import DataFrame

{imports}

__version__: str
__all__: list[str]
'''


def stub() -> str:
    """The stub as text."""
    imports = [f"from {home} import {name} as {name}" for name, home in workbench._HOMES.items()]
    parts = [HEAD.format(docstring=workbench.__doc__, imports="\n".join(sorted(imports)))]
    parts += [function_stub(name) for name in workbench._FUNCTIONS]
    return _formatted("\n".join(parts))


def function_stub(name: str) -> str:
    """Signature and docstring of the function of a command."""
    call = getattr(workbench, name)
    shown = [_parameter(one) for one in inspect.signature(call).parameters.values()]
    text = "\n".join(f"    {line}".rstrip() for line in call.__doc__.splitlines())
    return f'def {name}({", ".join(shown)}) -> Result:\n    r"""{text.strip()}\n    """\n'


def _parameter(parameter: inspect.Parameter) -> str:
    text = f"{parameter.name}: {parameter.annotation}"
    return text if parameter.default is parameter.empty else f"{text} = {parameter.default!r}"


def _formatted(text: str) -> str:
    command = [sys.executable, "-m", "ruff", "format", "--stdin-filename", STUB.name, "-"]
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=True)
    return done.stdout


def main() -> int:
    """Write or check; the exit status."""
    assert set(workbench._FUNCTIONS) == set(COMMANDS)
    if "--check" not in sys.argv:
        STUB.write_text(stub(), encoding="utf-8")
        return 0
    fresh = STUB.is_file() and STUB.read_text(encoding="utf-8") == stub()
    print(
        "workbench/__init__.pyi is up to date"
        if fresh
        else "workbench/__init__.pyi is stale: run python tools/api_stub.py"
    )
    return 0 if fresh else 1


if __name__ == "__main__":
    sys.exit(main())
