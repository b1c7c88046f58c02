"""The short notation of a board, such as "chessboard 11x8 5mm on tool"."""

import re

from datasets.importers.units import LENGTHS
from workbench.core.errors import InputError

_LENGTH = rf"\s+(\d*\.?\d+)\s*({'|'.join(LENGTHS)})"
_BOARD = re.compile(
    rf"(chessboard|checkerboard|circles|charuco|aprilgrid)\s+(\d+)\s*[x×]\s*(\d+){_LENGTH}"
    rf"(?:{_LENGTH}(?:\s+(DICT\w+))?)?(\s+asymmetric)?(\s+on\s+tool)?",
    re.IGNORECASE,
)


def board_keys(text: str) -> dict:
    """[board] of a notation such as "chessboard 11x8 5mm on tool". Raises InputError for another one."""
    match = _BOARD.fullmatch(text.strip())
    if match is None:
        raise InputError(
            f'--board "{text}": expected kind, inner corners and distance such as "chessboard 11x8 5mm", "circles 4x11 '
            '0.5in asymmetric", "charuco 7x5 30mm 22mm DICT_5X5_250" or "aprilgrid 6x6 71.5mm 55mm", with "on tool" '
            f"where the robot holds it, and lengths in {', '.join(LENGTHS)}; correct it."
        )
    kind, columns, rows, square, unit, marker, marker_unit, dictionary, is_asymmetric, on_tool = (
        match.groups()
    )
    keys: dict = {
        "kind": kind.lower().replace("checkerboard", "chessboard"),
        "columns": int(columns),
        "rows": int(rows),
        "square_mm": _mm(square, unit),
    }
    if marker:
        keys["marker_mm"] = _mm(marker, marker_unit)
    if dictionary:
        keys["dictionary"] = dictionary
    if is_asymmetric:
        keys["asymmetric"] = True
    if on_tool:
        keys["fixed_to"] = "tool"
    return keys


def _mm(value: str, unit: str) -> float:
    """A length in mm, to the digits of a number of few digits: 0.7 in are 17.78 mm."""
    return round(float(value) * LENGTHS[unit.lower()], 9)
