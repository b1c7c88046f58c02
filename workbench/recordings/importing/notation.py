"""The short notation of a board, such as "chessboard 11x8 5mm on tool"."""

import re

from workbench.core.errors import InputError

_BOARD = re.compile(
    r"(chessboard|checkerboard|circles|charuco|aprilgrid)\s+(\d+)\s*[x×]\s*(\d+)\s+([\d.]+)\s*mm"
    r"(?:\s+([\d.]+)\s*mm(?:\s+(DICT\w+))?)?(\s+asymmetric)?(\s+on\s+tool)?",
    re.IGNORECASE,
)


def board_keys(text: str) -> dict:
    """[board] of a notation such as "chessboard 11x8 5mm on tool". Raises InputError for another one."""
    match = _BOARD.fullmatch(text.strip())
    if match is None:
        raise InputError(
            f'--board "{text}": expected kind, inner corners and distance such as "chessboard 11x8 5mm", "circles 7x6 '
            '10mm asymmetric", "charuco 7x5 30mm 22mm DICT_5X5_250" or "aprilgrid 6x6 71.5mm 55mm", with "on tool" '
            "where the robot holds it; correct it."
        )
    kind = match[1].lower().replace("checkerboard", "chessboard")
    keys: dict = {
        "kind": kind,
        "columns": int(match[2]),
        "rows": int(match[3]),
        "square_mm": float(match[4]),
    }
    if match[5]:
        keys["marker_mm"] = float(match[5])
    if match[6]:
        keys["dictionary"] = match[6]
    if match[7]:
        keys["asymmetric"] = True
    if match[8]:
        keys["fixed_to"] = "tool"
    return keys
