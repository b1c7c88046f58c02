"""The size of an image from its header, so that a small file cannot ask for all memory when it is decoded."""

import struct

from workbench.core.errors import InputError

LIMIT_MB = 800
"""Largest decoded image, MB (10^6 bytes): 400 megapixels of 16 bits, or 100 of them with four channels."""
_PNG_CHANNELS = {0: 1, 2: 3, 3: 4, 4: 2, 6: 4}  # by colour type; a palette may become four channels


def check_decoded_size(content: bytes, called: str) -> None:
    """Raise InputError where the header of a PNG, JPEG or BMP file announces more than LIMIT_MB."""
    width, height, bytes_per_pixel = announced_size(content)
    size_mb = width * height * bytes_per_pixel / 1e6
    if size_mb > LIMIT_MB:
        raise InputError(
            f"{called}: expected an image of at most {LIMIT_MB} MB after decoding, found {width} x {height} pixels of "
            f"{bytes_per_pixel} bytes ({size_mb:.0f} MB); save it with fewer pixels or as 8-bit grey"
        )


def announced_size(content: bytes) -> tuple[int, int, int]:
    """Width, height and bytes of a pixel from the header; zeros where it is of another format or broken."""
    try:
        if content.startswith(b"\x89PNG\r\n\x1a\n"):
            width, height, depth, colour = struct.unpack(">IIBB", content[16:26])
            return width, height, _PNG_CHANNELS.get(colour, 4) * max(1, depth // 8)
        if content.startswith(b"\xff\xd8"):
            return _jpeg_size(content)
        if content.startswith(b"BM"):
            width, height = struct.unpack("<ii", content[18:26])
            return abs(width), abs(height), 4
    except (struct.error, IndexError):
        pass
    return 0, 0, 0


def _jpeg_size(content: bytes) -> tuple[int, int, int]:
    """From the first start-of-frame segment (ITU-T T.81, B.2.2)."""
    position = 2
    while content[position] == 0xFF:
        marker = content[position + 1]
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width, channels = struct.unpack(">HHB", content[position + 5 : position + 10])
            return width, height, max(channels, 1)
        position += 2 + struct.unpack(">H", content[position + 2 : position + 4])[0]
    return 0, 0, 0
