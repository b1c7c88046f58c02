"""Rows of a pose table that do not fit their images: gross errors, exchanged rows, and other mistakes of the poses."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from datasets.importers.source import RawTable
from sensors.hand_eye.checks.outlier_message import outlier_sentence
from sensors.hand_eye.checks.review import UNEXPLAINED, Review
from workbench.core.errors import InputError

_OPEN = (UNEXPLAINED, "scale")
"""Causes that name no mistake while the unit of the positions is open."""
_MOST_READINGS = 4
"""Readings that are searched for exchanged rows; more differ in units and conventions only."""


def pose_warnings(poses: np.ndarray, views, kind: str, rows: RawTable) -> tuple[str, ...]:
    """Sentences on mistakes of the poses (n, 4, 4) of a table, with the numbers of their rows.

    views: `BoardViews` of the tested images. kind: "in-hand" or "to-hand".
    """
    review = _review(poses, views, kind, rows)
    if review is None:
        return ()
    said = [_in_table(finding.sentence) for finding in review.findings]
    outliers = outlier_sentence(review, _row_names(views, rows))
    said = [sentence for sentence in (*said, outliers) if sentence]
    tested = len(views.rows)
    some = "" if tested == rows.n else f" {tested} of {rows.n} images were tested."
    return tuple(f"{rows.file}: {sentence}.{some}" for sentence in said)


def likely_mistake(readings: Sequence, views, kind: str, rows: RawTable) -> str | None:
    """The mistake that explains why the poses fit under no reading; None where no single one does.

    readings: (title, mapping, poses (n, 4, 4)) of the readings, the most probable first.
    """
    found = []
    for title, _, poses in readings[:_MOST_READINGS]:
        review = _review(poses, views, kind, rows)
        if review is None:
            continue
        found += [(title, finding) for finding in review.findings if finding.cause not in _OPEN]
    certain = [(title, finding) for title, finding in found if finding.certain]
    if not certain:
        return None
    title, finding = min(certain, key=lambda item: item[1].corrected_mm)
    return f"{rows.file}: read as {title}, {_in_table(finding.sentence)}."


def _review(poses: np.ndarray, views, kind: str, rows: RawTable) -> Review | None:
    """Whether poses and images fit each other; None where the images do not determine it."""
    from sensors.hand_eye.images import review_views

    names = _row_names(views, rows)
    named = [replace(view, image=name) for view, name in zip(views.found.views, names)]
    try:
        return review_views(named, views.found.board, views.camera, poses[views.rows], kind, ())
    except (InputError, np.linalg.LinAlgError):
        return None


def _in_table(sentence: str) -> str:
    """A sentence of the review with the user's table in the place of images.csv."""
    return sentence.replace("the column sample of images.csv", "the order of these rows")


def _row_names(views, rows: RawTable) -> list[str]:
    """Row and image of every tested pose, such as "row 7 (IMG_0012.png)"."""
    images = [view.image.rpartition("/")[2] for view in views.found.views]
    return [f"row {rows.lines[row]} ({image})" for row, image in zip(views.rows, images)]
