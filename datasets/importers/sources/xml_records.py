"""XML files whose elements are records: attributes such as j1 = "12.5" of equal elements are the columns of a table.

Staubli controllers store joint and Cartesian positions so (VAL3 .dtx: <Value key="0" j1="..." j2="..." ... />).
Attributes of single children belong to the record of their parent, as in logs of KUKA's RSI.
"""

import re
from pathlib import Path
from xml.etree.ElementTree import ParseError, fromstring

import numpy as np

from datasets.errors import complaint
from datasets.importers.source import RawTable

_FEWEST = 3
_DECLARATION = re.compile(r"<!(?:DOCTYPE|ENTITY)", re.IGNORECASE)


def read_xml_records(path: Path) -> list[RawTable]:
    """A table of every kind of element that occurs three times or more with the same numeric attributes.

    Raises InputError for text that is no XML, and where no elements are records.
    """
    text = path.read_text(encoding="utf-8", errors="replace")
    records: dict[tuple, list[dict[str, str]]] = {}
    for parent in _root(path, text).iter():
        for element in parent:
            row = _row(element)
            records.setdefault((id(parent), element.tag, tuple(row)), []).append(row)
    tables = [_table(path, rows) for rows in records.values() if len(rows) >= _FEWEST]
    tables = [table for table in tables if table.columns]
    if not tables:
        raise complaint(
            path.name,
            "an OpenCV FileStorage, or elements with numbers as attributes",
            "neither",
            "export the positions as CSV",
        )
    return tables


def _row(element) -> dict[str, str]:
    """Attributes of an element, and those of its children that have a tag of their own: "AIPos A1" of RSI."""
    row = dict(element.attrib)
    tags = [child.tag for child in element]
    for child in element:
        if tags.count(child.tag) == 1:
            row |= {f"{child.tag} {name}": value for name, value in child.attrib.items()}
    return row


def _root(path: Path, text: str):
    """The root element. Raises InputError; entities are not expanded, because they can fill the memory."""
    try:
        if _DECLARATION.search(text):
            raise ParseError("entities are not read")
        # an undeclared prefix, as in xsi:type, is an error for the parser and means nothing here
        return fromstring(re.sub(r"\b\w+:(\w+)=", r"_\1=", text))
    except (ParseError, ValueError) as problem:
        raise complaint(path.name, "XML", f"a mistake ({problem})", "write it again") from None


def _table(path: Path, rows: list[dict[str, str]]) -> RawTable:
    """Attributes that are numbers in all elements, and the others as text where one of them is a number."""
    columns: dict[str, np.ndarray] = {}
    has_numbers = False
    for name in rows[0]:
        cells = [row[name] for row in rows]
        try:
            columns[name] = np.array([float(cell) for cell in cells])
            has_numbers = True
        except ValueError:
            columns[name] = np.array(cells)
    return RawTable(path.name, columns if has_numbers else {}, np.arange(1, len(rows) + 1))
