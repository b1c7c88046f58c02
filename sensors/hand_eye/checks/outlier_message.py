"""A sentence on images whose flange poses are gross errors."""

from collections.abc import Sequence

from sensors.hand_eye.checks.review import Review

_NAMED = 6


def outlier_sentence(review: Review, names: Sequence[str]) -> str | None:
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
        f"the flange poses of {len(ordered)} of {count} images do not fit those of the others: the board seems to be "
        f"displaced in {', '.join(words)}; check the pose and the image of these rows, and correct or remove them"
    )
