"""Nouns of the messages: flange poses are compared with images of a board, or with measured poses of a target."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Nouns:
    """What is compared with the flange poses, and where a mistake in it is corrected.

    `sample`, `a_sample`, `samples`: what a flange pose belongs to. `measured`: what the flange poses must fit, and
    `moment` one of them. `target`: what is seen, `size_subject` what a wrong length makes look too large. `size`: the
    length that is stated for it, `size_source` where that is stated, and `size_name` its short name. `order`: states
    which sample has which pose. `pose_and_sample`: what is checked in a row that does not fit. `mirrored`,
    `unmirror`: a reflection. `repeat`: measures once more.
    """

    sample: str
    a_sample: str
    samples: str
    measured: str
    moment: str
    target: str
    size_subject: str
    size: str
    size_source: str
    size_name: str
    order: str
    pose_and_sample: str
    mirrored: str
    unmirror: str
    repeat: str


BOARD_IMAGES = Nouns(
    sample="image",
    a_sample="an image",
    samples="images",
    measured="images",
    moment="image",
    target="board",
    size_subject="the squares of the board look",
    size="the board's square",
    size_source="square_mm under [board]",
    size_name="square_mm",
    order="the column sample of images.csv",
    pose_and_sample="the pose and the image",
    mirrored="image",
    unmirror="the flip of the image",
    repeat="take the images again",
)
TARGET_POSES = Nouns(
    sample="row",
    a_sample="a row",
    samples="rows",
    measured="measured poses of the target",
    moment="pose of the target",
    target="target",
    size_subject="the target looks",
    size="the size of the target",
    size_source="the size of the target in the program that measured it",
    size_name="size of the target",
    order="the order of the rows",
    pose_and_sample="both poses",
    mirrored="frame of the target",
    unmirror="the reflection of the target's frame",
    repeat="measure again",
)
