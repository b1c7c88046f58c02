"""`workbench doctor`: prints the checks of `workbench.machine.doctor` and the commands that fix them."""

import typer

from workbench.commands.shared import answer
from workbench.machine.doctor import OPTIONAL


def command(json: answer.JsonTarget = None) -> None:
    """Check the installation: Python, libraries, system packages, device, recordings, permissions."""
    answer.check_target(json)
    with answer.progress("loading every library once"):
        from workbench.machine.doctor import as_json, examine

        checks = examine()
    result = as_json(checks)
    answer.deliver(result, json)
    _show(answer.console(json), checks, result)
    raise typer.Exit(0 if result["healthy"] else 1)


def _show(console, checks, result) -> None:
    marks = {True: "[green]ok[/]", False: "[red]missing[/]"}
    for check in checks:
        mark = marks[check.ok] if check.ok or check.required else "[yellow]without[/]"
        console.print(f"{mark:>20}  {check.name}  ", end="")
        console.print(check.found, markup=False, soft_wrap=True)
        if check.advice and not check.ok:
            console.print(f"           {check.advice}", markup=False, soft_wrap=True)
    last = "All requirements are met." if result["healthy"] else "A requirement is missing."
    missing = [check.name for check in checks if check.name in OPTIONAL and not check.ok]
    if missing:
        last += f" Optional packages are missing: {', '.join(missing)}; the lines above say which command needs them."
    console.print(last, soft_wrap=True)
