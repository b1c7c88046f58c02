"""Checks of PLY and PCD files before Open3D reads them.

The PLY parser in Open3D (RPly) overflows a buffer of 1,024 bytes when it reports a long word, and accesses wrong
memory after some words that are no types; both parsers allocate what a header announces. The process then ends. No
file needs such words, or can hold more points than its size allows.
"""

import re
from pathlib import Path

_LONGEST = 200
_COMPRESSION = 300  # LZF of PCD shortens by less
_WORD = re.compile(rb"[^\s]{%d}" % _LONGEST)
_HEADER_BYTES = 65_536
_TYPE = rb"(?:u?(?:char|short|int)|u?int(?:8|16|32)|float(?:32|64)?|double)"
_PLY_LINE = re.compile(
    rb"ply|format\s+\S+\s+1\.0|(?:comment|obj_info)\b.*|element\s+\S+\s+\S+"
    rb"|property\s+(?:list\s+%b\s+)?%b\s+\S+" % (_TYPE, _TYPE)
)
"""A line in the header of a PLY file: Turk, The PLY polygon file format (1994)."""
_END = re.compile(rb"^end_header[ \t]*\r?$", re.MULTILINE)


def ply_problem(path: Path) -> str:
    """Why a file is no PLY file that can be parsed, as a part of a sentence; "" where it is one."""
    with Path(path).open("rb") as file:
        start = file.read(_HEADER_BYTES)
        end = _END.search(start.replace(b"\r", b"\n"))
        if not start.startswith(b"ply") or not end:
            return "no header of a PLY file"
        header = start[: end.start()]
        if _WORD.search(header):
            return f"a header with a word of {_LONGEST} characters or more"
        for line in filter(None, map(bytes.strip, header.splitlines())):
            if not _PLY_LINE.fullmatch(line):
                return f"the line '{line.decode('ascii', 'replace')}' in the header"
        is_ascii = re.search(rb"^format\s+ascii\b", header, re.MULTILINE)
        binary = re.search(rb"^format\s+binary_(little|big)_endian\b", header, re.MULTILINE)
        if not is_ascii and not binary:
            return "a format that is neither ascii nor binary"
        if is_ascii and _has_long_word(start, file):
            return f"a number of {_LONGEST} characters or more"
        counts = re.findall(rb"^element[ \t]+\S+[ \t]+(\S+)", header, re.MULTILINE)
    return _count_problem(counts, Path(path).stat().st_size)


def pcd_problem(path: Path) -> str:
    """Why a file is no PCD file that can be parsed, as a part of a sentence; "" where it is one."""
    with Path(path).open("rb") as file:
        header, found, _ = file.read(_HEADER_BYTES).partition(b"\nDATA ")
    if not found:
        return "no header of a PCD file"
    if _WORD.search(header):
        return f"a header with a word of {_LONGEST} characters or more"
    numbers = re.findall(rb"^(?:WIDTH|HEIGHT|POINTS)[ \t]+(\S+)", header, re.MULTILINE)
    sizes = re.findall(rb"^(?:SIZE|COUNT)[ \t]+([^\n]*)", header, re.MULTILINE)
    largest = _COMPRESSION * Path(path).stat().st_size
    return _count_problem(numbers, largest) or _count_problem(b" ".join(sizes).split(), 1000)


def _count_problem(counts: list[bytes], limit: int) -> str:
    """A sentence part for the first count that is no number, or above `limit`."""
    for count in counts:
        if not count.isdigit() or int(count) > limit:
            return f"a header that announces {count.decode('ascii', 'replace')} elements"
    return ""


def _has_long_word(start: bytes, file) -> bool:
    """Whether the text has a long word, read in parts that overlap by one word."""
    part = start
    while part:
        if _WORD.search(part):
            return True
        following = file.read(2**20)
        part = part[-_LONGEST:] + following if following else b""
    return False
