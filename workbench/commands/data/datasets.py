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
    rows = known()
    answer.deliver({"command": "datasets list", "datasets": rows}, json)
    console = answer.console(json)
    tables.grid(
        console,
        "Recordings",
        ["name", "measures", "here", "licence"],
        [
            [_names(row), row["measures"], "yes" if row["folder"] else "no", row["licence"]]
            for row in rows
        ],
        left=4,
    )
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


@app.command("path", short_help="Print the folder of a recording.")
def path(name: Name, json: answer.JsonTarget = None) -> None:
    """Print the folder of a recording."""
    answer.check_target(json)
    import datasets
    from datasets import registry

    found = _bundled().get(name) or datasets.find(name)
    if found is None:
        places = " or ".join(map(str, registry.places()))
        raise InputError(
            f"{name} is expected in {places} and found in neither; fetch it with "
            f"`workbench datasets get {name}`, or set {registry.SETTING}."
        )
    _deliver("datasets path", name, found, json)


def known() -> list[dict]:
    """One row per recording: name, title, measures, variants, licence, url, folder (None: not on this machine)."""
    import datasets

    bundled = [datasets.read(folder) for folder in _bundled().values()]
    user_datasets = [
        {
            "name": name,
            "title": found.title,
            "measures": found.measures,
            "variants": [""],
            "licence": "comes with the workbench",
            "url": None,
            "folder": folder,
        }
        for (name, folder), found in zip(_bundled().items(), bundled)
    ]
    return user_datasets + datasets.listing()


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
