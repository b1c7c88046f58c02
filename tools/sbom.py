"""Software bill of materials of the installed environment: CycloneDX 1.5 JSON, and a list of licences.

`python tools/sbom.py FOLDER` writes FOLDER/sbom.cdx.json and FOLDER/licences.csv for the project and all packages
that its required dependencies need on this system, as they are installed.
"""

import csv
import json
import re
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement

PROJECT = "vision-sensor-workbench"


def main(folder: Path) -> int:
    """Write both files; exit status 1 where a dependency is not installed."""
    found, missing = closure(PROJECT)
    folder.mkdir(parents=True, exist_ok=True)
    rows = [described(name) for name in sorted(found)]
    document = json.dumps(bill(rows), indent=1) + "\n"
    (folder / "sbom.cdx.json").write_text(document, encoding="utf-8")
    with (folder / "licences.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, ["name", "version", "licence", "home"])
        table.writeheader()
        table.writerows(rows)
    print(
        f"{len(rows)} packages in {folder}; not installed: {', '.join(sorted(missing)) or 'none'}"
    )
    return int(bool(missing))


def closure(start: str) -> tuple[set[str], set[str]]:
    """Names of all packages that a package needs on this system: installed ones, and missing ones."""
    found, missing, left = set(), set(), [(start, "")]
    seen = set()
    while left:
        name, extra = left.pop()
        if (name, extra) in seen:
            continue
        seen.add((name, extra))
        try:
            requirements = distribution(name).requires or []
        except PackageNotFoundError:
            missing.add(name)
            continue
        found.add(name)
        for text in requirements:
            left += needed(Requirement(text), extra)
    return found, missing


def needed(requirement: Requirement, extra: str) -> list[tuple[str, str]]:
    """(name, extra) pairs of a requirement where its marker holds here."""
    if requirement.marker and not requirement.marker.evaluate({"extra": extra}):
        return []
    name = re.sub(r"[-_.]+", "-", requirement.name).lower()
    return [(name, one) for one in ("", *sorted(requirement.extras))]


def described(name: str) -> dict:
    """Name, version, licence and home page from the metadata of an installed package."""
    metadata = distribution(name).metadata
    classifiers = [c for c in metadata.get_all("Classifier") or [] if c.startswith("License ::")]
    stated = metadata.get("License-Expression") or (metadata.get("License") or "").strip()
    licence = stated if stated and len(stated) < 80 else ""
    licence = licence or "; ".join(c.rpartition("::")[2].strip() for c in classifiers)
    urls = [url.partition(",")[2].strip() for url in metadata.get_all("Project-URL") or []]
    home = metadata.get("Home-page") or next(iter(urls), "")
    return {
        "name": name,
        "version": metadata["Version"],
        "licence": licence or "not stated",
        "home": home,
    }


def bill(rows: list[dict]) -> dict:
    """The CycloneDX document. It has no time stamp, so that equal environments give equal files."""
    components = [component(row) for row in rows]
    own = [one for one in components if one["name"] == PROJECT]
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {"component": own[0] | {"type": "application"}} if own else {},
        "components": [one for one in components if one["name"] != PROJECT],
    }


def component(row: dict) -> dict:
    """A component of the bill with its package URL (PyPI)."""
    return {
        "type": "library",
        "name": row["name"],
        "version": row["version"],
        "purl": f"pkg:pypi/{row['name']}@{row['version']}",
        "licenses": [{"license": {"name": row["licence"]}}],
    }


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "dist")))
