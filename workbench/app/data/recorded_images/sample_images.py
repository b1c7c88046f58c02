"""Image of a sample: that of the light plane nearest to the measured ball, else the middle one."""

from collections import defaultdict

import numpy as np

from workbench.app.data.opened import Opened
from workbench.app.data.sensor import scanner_of

_POINT = ("x_mm", "y_mm", "z_mm")


def sample_images(opened: Opened) -> dict[int, int]:
    """Number of each sample that has images -> place in images.csv of the one that shows it best.

    A scan sweeps over the ball and past it, so that its middle image may show nothing.
    """
    places: dict[int, list[int]] = defaultdict(list)
    for place, row in enumerate(opened.recording.images):
        if row.get("sample") is not None:
            places[row["sample"]].append(place)
    nearest = _nearest_steps(opened) if places else {}
    return {number: _best(opened, found, nearest.get(number)) for number, found in places.items()}


def _best(opened: Opened, places: list[int], step: int | None) -> int:
    """The image of a step of the light among the images of one sample; the middle one where there is none."""
    images = opened.recording.images
    of_step = [place for place in places if step is not None and images[place].get("step") == step]
    found = of_step or places
    return found[len(found) // 2]


def _nearest_steps(opened: Opened) -> dict[int, int]:
    """Number of a sample -> step of the light whose plane is nearest to the measured point; {} without a scanner."""
    scanner = scanner_of(opened)
    columns = opened.samples.columns
    if scanner is None or not set(_POINT) <= set(columns):
        return {}
    points = np.stack([columns[name][opened.rows] for name in _POINT])
    normals = scanner.planes[:3]
    offsets = scanner.planes[3]
    distances = normals.T @ points + offsets[:, None]
    nearest = np.asarray(scanner.steps)[np.abs(distances).argmin(axis=0)]
    first_of_each = np.unique(opened.edit_ids, return_index=True)[1]
    numbers = opened.edit_ids[first_of_each].tolist()
    return dict(zip(numbers, nearest[first_of_each].tolist()))
