"""Every page of the documentation site shows an image that exists; the images are those that the tools draw."""

import re
import sys
from tempfile import gettempdir
from xml.etree import ElementTree

import cv2
import pytest
import yaml

from conftest import ROOT

sys.path.insert(0, str(ROOT / "tools"))

import page_images
import schema_page

DOCS = ROOT / "docs"
LINK = re.compile(r"!\[([^\]]*)\]\(([^)\s]+)\)")
# A page that `make docs` writes, with the text above its tables.
GENERATED = {"reference/files.md": schema_page.HEAD}


def pages() -> list[str]:
    """Every page of the navigation."""
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    return list(_leaves(yaml.safe_load(text)["nav"]))


def _leaves(entry):
    if isinstance(entry, str):
        yield entry
    for inner in entry.values() if isinstance(entry, dict) else entry:
        if not isinstance(entry, str):
            yield from _leaves(inner)


def text_of(page: str) -> str:
    return GENERATED.get(page) or (DOCS / page).read_text(encoding="utf-8")


@pytest.mark.parametrize("page", pages())
def test_a_page_shows_an_image_that_exists_and_says_what_it_shows(page):
    found = LINK.findall(text_of(page))
    assert found, f"{page} has no image; draw one with tools/page_images.py"
    for alternative, target in found:
        file = (DOCS / page).parent / target
        assert file.is_file(), f"{page} shows {target}, which does not exist"
        assert alternative.strip(), f"{page}: say in words what {target} shows"


@pytest.mark.parametrize("name", page_images.names())
def test_a_drawn_image_is_readable_and_shown_on_a_page(name):
    files = [file for file in (DOCS / "images").iterdir() if file.stem == name]
    assert len(files) == 1, f"python tools/page_images.py {name}"
    assert is_drawn(files[0])
    assert any(f"images/{files[0].name})" in text_of(page) for page in pages())


def is_drawn(file) -> bool:
    """Whether an image has content, and an SVG nothing from the network or from the machine that drew it."""
    if file.suffix == ".svg":
        text = file.read_text(encoding="utf-8")
        words = "".join(ElementTree.fromstring(text).itertext())
        return "$" in words and "@font-face" not in text and gettempdir() not in text
    image = cv2.imread(str(file))
    return image is not None and image.std() > 1


def test_no_image_is_left_that_no_tool_draws():
    assert {file.stem for file in (DOCS / "images").iterdir()} == set(page_images.names())


def test_an_unknown_image_is_refused(capsys):
    assert page_images.main(["no-such-image"]) == 2
    assert "no-such-image" in capsys.readouterr().err


def test_every_link_of_the_readme_leads_somewhere():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#\s]+)", text)
    here = [target for target in targets if "://" not in target]
    assert len(here) > 10
    made = {f"docs/{page}" for page in GENERATED}
    missing = [target for target in here if target not in made and not (ROOT / target).exists()]
    assert not missing
