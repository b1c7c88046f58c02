"""A line laser on a board of 7 x 7 circles: 12 placements, each without and with the laser, 1920 x 1080.

The pitch of the circles was not published, so that every length counts in pitches: square_mm = 1
stands for one pitch. Focal lengths, distortion and angles do not depend on it.
"""

from pathlib import Path

from datasets.formats.native import checked, image_recording
from datasets.recording import Recording

BOARD = {"kind": "circles", "columns": 7, "rows": 7, "square_mm": 1.0}
PLACEMENTS = 12
FOLDERS = {"board": "calib_picture/calib", "board-laser": "light_picture/light"}
TITLE = "Line laser on a board of 7 x 7 circles; pitch unknown: 1 mm stands for one circle pitch"


def read(folder: Path, variant: str) -> Recording:
    """Pairs of images; `placement` is the number in the files' names. One light plane: there is no `step`."""
    rows = [
        {"image": f"{stem}{k}.jpg", "role": role, "placement": str(k)}
        for k in range(PLACEMENTS)
        for role, stem in FOLDERS.items()
    ]
    paths = checked(folder, *(row["image"] for row in rows))
    return image_recording("scan-images", rows, BOARD, paths, TITLE)
