"""Building blocks of a page: sections of text, figures, tables, notes and thumbnails."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import plotly.graph_objects as go

from workbench.report import style

_THUMBNAIL = 240


@dataclass(frozen=True)
class Section:
    """A section: `name` is its anchor; `blocks` come from the functions of this module."""

    name: str
    title: str
    blocks: tuple[dict, ...]


@dataclass(frozen=True)
class Page:
    """A page: `over` is the small line above `title`; `numbers` (name, value, unit) are set in large type.

    `lead`: sentences below the numbers.
    """

    over: str
    title: str
    numbers: tuple[tuple[str, str, str], ...]
    lead: tuple[str, ...]
    sections: tuple[Section, ...]
    warning: str = ""
    answer: str = "answer.json"
    caption: str = ""
    files: tuple[str, ...] = field(default=())


def words(text: str, quiet: bool = False) -> dict:
    """A paragraph."""
    return {"kind": "words", "text": text, "quiet": quiet}


def figure(name: str, plot: go.Figure, caption: str) -> dict:
    """A plotly figure; `name` is its identifier, unique on the page."""
    return {"kind": "figure", "name": name, "data": style.packed(plot), "caption": caption}


def pair(*figures: dict) -> dict:
    """Figures side by side, if the page is wide enough."""
    return {"kind": "pair", "figures": figures}


def table(
    head: Sequence[str], rows: Sequence[Sequence], left: int = 1, last_is_text: bool = False
) -> dict:
    """A table. Its first `left` columns, and the last if asked for, are text; the others are formatted numbers."""
    return {
        "kind": "table",
        "head": list(head),
        "rows": [list(map(str, row)) for row in rows],
        "left": left,
        "numbers_end": len(head) - last_is_text,
    }


def facts(lines: Sequence[tuple[str, str]]) -> dict:
    """A list of names with a text for each."""
    return {
        "kind": "facts",
        "lines": [(name, str(text)) for name, text in lines if text not in (None, "")],
    }


def note(title: str, lines: Sequence[str]) -> dict:
    """A highlighted box of sentences."""
    return {"kind": "note", "title": title, "lines": list(lines)}


def thumbnails(images: Sequence[tuple[Path, str]]) -> dict:
    """Thumbnails of image files, embedded in the page, each with a caption."""
    return {"kind": "thumbnails", "images": [(thumbnail(path), text) for path, text in images]}


def images(sources: Sequence[tuple[str, str]]) -> dict:
    """Images as data addresses, each with its sentence."""
    return {"kind": "images", "images": [(source, text) for source, text in sources if source]}


def links(lines: Sequence[tuple[str, str]]) -> dict:
    """A list of (address, link text)."""
    return {"kind": "links", "lines": list(lines)}


def image(path: Path, caption: str) -> dict:
    """A PNG file, embedded in the page."""
    code = base64.b64encode(Path(path).read_bytes()).decode()
    return {"kind": "image", "source": f"data:image/png;base64,{code}", "caption": caption}


def thumbnail(path: Path) -> str:
    """Data address of a thumbnail of the image at `path`; "" if the file is not readable."""
    import cv2

    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None or not image.size:
        return ""
    scale = _THUMBNAIL / max(image.shape)
    if scale < 1:
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    else:
        small = image
    code = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 70])[1]
    return "data:image/jpeg;base64," + base64.b64encode(code.tobytes()).decode()
