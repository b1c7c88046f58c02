"""A sentence on images whose flange poses are gross errors."""

from collections.abc import Sequence

from sensors.hand_eye.checks.nouns import BOARD_IMAGES, Nouns
from sensors.hand_eye.checks.review import Review

_NAMED = 6


def outlier_sentence(
    review: Review, names: Sequence[str], nouns: Nouns = BOARD_IMAGES
) -> str | None:
    """State what is wrong with the outlying images of a review, and what to do; None where there are none.

    names: of the images, or of the rows with their poses.
    """
    if not review.outliers:
        return None
    ordered = sorted(review.outliers, key=lambda image: -review.fit.distance[image])
    words = [f"{names[image]} ({review.fit.distance[image]:.3g} mm)" for image in ordered[:_NAMED]]
    if len(ordered) > _NAMED:
        words.append(f"{len(ordered) - _NAMED} more")
    count = len(review.fit.distance)
    return (
        f"the flange poses of {len(ordered)} of {count} {nouns.samples} do not fit those of the others: the "
        f"{nouns.target} seems to be displaced in {', '.join(words)}; check {nouns.pose_and_sample} of these rows, "
        "and correct or remove them"
    )
