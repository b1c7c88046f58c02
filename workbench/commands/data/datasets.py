"""`workbench datasets`: known recordings, their folders and their download."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer, tables
from workbench.core.errors import InputError

app = typer.Typer(help="List, download or locate the recordings that are known by name.")
Name = Annotated[str, typer.Argument(help="A name from `workbench datasets list`.")]


@app.command("list", short_help="List known recordings and their folders.")
def listing(json: answer.JsonTarget = None) -> None:
    """List the recordings that are known by name: bundled ones, and real ones with their source."""
    answer.check_target(json)
    recordings = known()
    answer.deliver({"command": "datasets list", "datasets": recordings}, json)
    console = answer.console(json)
    head = ["name", "measures", "here", "licence"]
    tables.grid(console, "Recordings", head, list(map(_listed, recordings)), left=4)
    console.print("`workbench datasets get NAME` fetches one that is not here.", markup=False)


@app.command("get", short_help="Download a recording from its public source.")
def get(
    name: Name,
    folder: Annotated[
        Path | None, typer.Argument(help="Folder to write instead of the cache.")
    ] = None,
    json: answer.JsonTarget = None,
) -> None:
    """Download a recording from its public source and verify every file."""
    answer.check_target(json)
    import datasets

    if not (found := _bundled().get(name)):
        with answer.progress(f"fetching {name}"):
            found = datasets.get(name, folder)
    _deliver("datasets get", name, found, json)


def _listed(recording: dict) -> list[str]:
    """Its row of the table."""
    is_here = "yes" if recording["folder"] else "no"
    return [_names(recording), recording["measures"], is_here, recording["licence"]]


@app.command("path", short_help="Print the folder of a recording.")
def path(name: Name, json: answer.JsonTarget = None) -> None:
    """Print the folder of a recording."""
    answer.check_target(json)
    import datasets
    from datasets import registry

    found = _bundled().get(name) or datasets.find(name)
    if found is None:
        raise _not_here(name, registry)
    _deliver("datasets path", name, found, json)


def _not_here(name: str, registry) -> InputError:
    places = " or ".join(map(str, registry.places()))
    return InputError(
        f"{name} is expected in {places} and found in neither; fetch it with "
        f"`workbench datasets get {name}`, or set {registry.SETTING}."
    )


def known() -> list[dict]:
    """One row per recording: name, title, measures, variants, licence, url, folder (None: not on this machine)."""
    import datasets

    bundled = [
        _bundled_row(name, folder, datasets.read(folder)) for name, folder in _bundled().items()
    ]
    return bundled + datasets.listing()


def _bundled_row(name: str, folder: Path, recording) -> dict:
    return {
        "name": name,
        "title": recording.title,
        "measures": recording.measures,
        "variants": [""],
        "licence": "comes with the workbench",
        "url": None,
        "folder": folder,
    }


def _bundled() -> dict[str, Path]:
    from datasets.reading import bundled

    return bundled()


def _names(row: dict) -> str:
    """The names of a recording, one per line, with its variants after a colon."""
    return "\n".join(
        f"{row['name']}:{variant}" if variant else row["name"] for variant in row["variants"]
    )


def _deliver(command: str, name: str, folder: Path, json: str | None) -> None:
    answer.deliver({"command": command, "dataset": name, "folder": folder}, json)
    answer.console(json).print(str(folder), soft_wrap=True, markup=False)
