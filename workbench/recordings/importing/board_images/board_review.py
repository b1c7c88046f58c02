"""Rows of a pose table that do not fit their images: gross errors, exchanged rows, and other mistakes of the poses."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from datasets.importers.source import RawTable
from datasets.samples.columns import FLANGE
from sensors.hand_eye.checks.mistakes import Reading, pose_readings
from sensors.hand_eye.checks.outlier_message import outlier_sentence
from sensors.hand_eye.checks.review import UNEXPLAINED, Review
from workbench.core.errors import InputError

_OPEN = (UNEXPLAINED, "scale")
"""Causes that name no mistake while the unit of the positions is open."""
_OF_ROWS = ("shifted", "reversed")
_OF_FRAMES = ("mirrored", "position-sign", "position-order")
_MOST_READINGS = 8
"""Readings that are searched for mistakes of the poses; more differ in units only."""
_CLOSE = 1.5


def pose_warnings(poses: np.ndarray, views, kind: str, rows: RawTable) -> tuple[str, ...]:
    """Sentences on mistakes of the poses (n, 4, 4) of a table, with the numbers of their rows.

    views: `BoardViews` of the tested images. kind: "in-hand" or "to-hand".
    """
    review = _review(poses, views, kind, rows)
    if review is None:
        return ()
    sentences = [_in_table(finding.sentence) for finding in review.findings]
    outliers = outlier_sentence(review, _row_names(views, rows))
    sentences = [sentence for sentence in (*sentences, outliers) if sentence]
    tested = len(views.rows)
    if tested == rows.n:
        tested_sentence = ""
    else:
        tested_sentence = f" {tested} of {rows.n} images were tested."
    return tuple(f"{rows.file}: {sentence}.{tested_sentence}" for sentence in sentences)


def likely_mistake(readings: Mapping[int, tuple], views, kind: str, rows: RawTable) -> str | None:
    """The mistake that explains why the poses fit under no reading; None where no single one does.

    readings: (title, mapping, poses (n, 4, 4)) by their place in the order of how usual they are; those that fit best
    first. Among mistakes that explain the poses as well, that of the most usual reading is named.
    """
    found = []
    for place, (title, mapping, poses) in list(readings.items())[:_MOST_READINGS]:
        review = _review(poses, views, kind, rows, _untested(mapping, poses, views))
        if review is None:
            continue
        found += [
            (place, title, finding) for finding in review.findings if finding.cause not in _OPEN
        ]
    certain = [row for row in found if row[2].certain]
    if not certain:
        return None
    min_mm = min(finding.corrected_mm for _, _, finding in certain)
    close = [row for row in certain if row[2].corrected_mm <= _CLOSE * min_mm]
    _, title, finding = min(close, key=lambda row: row[0])
    return f"{rows.file}: read as {title}, {_in_table(finding.sentence)}."


def _untested(mapping, poses: np.ndarray, views) -> tuple[Reading, ...]:
    """Mistakes of the poses (n, 4, 4) that are no reading of the table, in the words of its columns.

    Signs of position columns, a left-handed frame, position columns in another order, and rows that are shifted or
    reversed; of joint readings only the latter.
    """
    causes = _OF_ROWS if mapping.flange_point is None else (*_OF_ROWS, *_OF_FRAMES)
    tested = [
        replace(reading, flange=reading.flange[views.rows])
        for reading in pose_readings(poses)
        if reading.cause in causes
    ]
    if mapping.flange_point is None:
        return tuple(tested)
    names = dict(zip(FLANGE, mapping.flange_point.columns))

    def named(text: str) -> str:
        for column, user_column in names.items():
            text = text.replace(column, f"column {user_column}")
        return text

    return tuple(
        replace(reading, symptom=named(reading.symptom), do=named(reading.do)) for reading in tested
    )


def _review(
    poses: np.ndarray, views, kind: str, rows: RawTable, readings: Sequence[Reading] = ()
) -> Review | None:
    """Whether poses and images fit each other; None where the images do not determine it.

    readings: other readings of the poses at the tested images, to try.
    """
    from sensors.hand_eye.images import review_views

    names = _row_names(views, rows)
    named = [replace(view, image=name) for view, name in zip(views.found.views, names)]
    try:
        return review_views(
            named, views.found.board, views.camera, poses[views.rows], kind, readings
        )
    except (InputError, np.linalg.LinAlgError):
        return None


def _in_table(sentence: str) -> str:
    """A sentence of the review with the user's table in the place of images.csv."""
    return sentence.replace("the column sample of images.csv", "the order of these rows")


def _row_names(views, rows: RawTable) -> list[str]:
    """Row and image of every tested pose, such as "row 7 (IMG_0012.png)"."""
    images = [view.image.rpartition("/")[2] for view in views.found.views]
    return [f"row {rows.lines[row]} ({image})" for row, image in zip(views.rows, images)]
