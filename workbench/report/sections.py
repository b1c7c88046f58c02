"""What a page is made of: sections of words, figures, tables, notes and small images."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import plotly.graph_objects as go

from workbench.report import style

_THUMBNAIL = 240


@dataclass(frozen=True)
class Section:
    """One section: `name` its anchor, `title`, and `blocks` made by the functions below."""

    name: str
    title: str
    blocks: tuple[dict, ...]


@dataclass(frozen=True)
class Page:
    """A page: `over` small above `title`; `numbers` (name, value, unit) in large; `lead` sentences under them."""

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


def figure(name: str, made: go.Figure, caption: str) -> dict:
    """A plotly figure under an identifier that is unique on the page."""
    return {"kind": "figure", "name": name, "data": style.packed(made), "caption": caption}


def pair(*figures: dict) -> dict:
    """Figures beside one another, where there is room."""
    return {"kind": "pair", "figures": figures}


def table(head: Sequence[str], rows: Sequence[Sequence], left: int = 1) -> dict:
    """A table whose first `left` columns are words and the rest numbers already written."""
    return {
        "kind": "table",
        "head": list(head),
        "rows": [list(map(str, row)) for row in rows],
        "left": left,
    }


def facts(lines: Sequence[tuple[str, str]]) -> dict:
    """Names and what is to be said of each."""
    return {
        "kind": "facts",
        "lines": [(name, str(text)) for name, text in lines if text not in (None, "")],
    }


def note(title: str, lines: Sequence[str]) -> dict:
    """A box of sentences that must not be missed."""
    return {"kind": "note", "title": title, "lines": list(lines)}


def thumbnails(images: Sequence[tuple[Path, str]]) -> dict:
    """Small copies of image files, inside the page, each with its sentence."""
    return {"kind": "thumbnails", "images": [(thumbnail(path), text) for path, text in images]}


def images(sources: Sequence[tuple[str, str]]) -> dict:
    """Images as data addresses, each with its sentence."""
    return {"kind": "images", "images": [(source, text) for source, text in sources if source]}


def links(lines: Sequence[tuple[str, str]]) -> dict:
    """A list of addresses, each with its words."""
    return {"kind": "links", "lines": list(lines)}


def image(path: Path, caption: str) -> dict:
    """A PNG file, inside the page."""
    code = base64.b64encode(Path(path).read_bytes()).decode()
    return {"kind": "image", "source": f"data:image/png;base64,{code}", "caption": caption}


def thumbnail(path: Path) -> str:
    """A data address of a small copy of the image at `path`; "" where it cannot be read."""
    import cv2

    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None or not image.size:
        return ""
    scale = _THUMBNAIL / max(image.shape)
    small = (
        cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        if scale < 1
        else image
    )
    code = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 70])[1]
    return "data:image/jpeg;base64," + base64.b64encode(code.tobytes()).decode()
