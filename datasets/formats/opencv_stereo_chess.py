"""OpenCV's sample stereo pairs: 13 + 13 images of a chessboard of 9 x 6 inner corners, 25 mm squares.

Two cameras, one variant each; one value of `placement` shows the same instant.
"""

from pathlib import Path

from datasets.formats.native import checked, image_recording
from datasets.recording import Recording

BOARD = {"kind": "chessboard", "columns": 9, "rows": 6, "square_mm": 25.0}
NUMBERS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14)


def read(folder: Path, variant: str) -> Recording:
    """Images of the camera that `variant` names; `placement` is the number in the file's name."""
    names = [f"{variant}{k:02d}.jpg" for k in NUMBERS]
    rows = [
        {"image": name, "role": "board", "placement": str(k)} for name, k in zip(names, NUMBERS)
    ]
    return image_recording(
        "board-images", rows, BOARD, checked(folder, *names), f"Chessboard, {variant} camera"
    )
