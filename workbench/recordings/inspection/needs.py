"""List what a recording lacks for each command, with what to do about it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from datasets.recording import Recording
from datasets.samples.columns import KINDS, joint_columns, joint_number
from robot_model import load_robot
from robot_model.measurements import samples_of
from workbench.core.errors import InputError
from workbench.core.vocabulary import Covariate
from workbench.fitting.plausibility import check_plausibility
from workbench.fitting.plausibility.joint_columns.small_mistakes import untested_signs
from workbench.fitting.plausibility.robot_files.far_geometry import (
    CAUSE,
    OTHER_ROBOT,
    find_far_geometry,
)
from workbench.fitting.plausibility.wording import fit_words
from workbench.recordings.inspection.coverage import Coverage, ImageCoverage, coverage_of
from workbench.recordings.inspection.repeats import Repeats

_COMPONENTS = {
    "ball-centre": 3,
    "external-point": 3,
    "external-pose": 6,
    "partial-pose": 5,
    "touch-point": 3,
    "laser-spot": 2,
    "distance": 0.5,
    "plane-touch": 1,
    "ball-surface": 3,
}
_SMALL_SHARE, _SMALL_DEG, _SMALL_MM, _MIN_EXTENT = 0.3, 40.0, 100.0, 1e-3
_MODERATE = 120.0  # deg or mm: a range this large determines the joint, however wide its limits are
_SMALL_SPREAD_DEG = 20.0
_FEW_IMAGES, _LEAST_IMAGES, _FIELD = 10, 4, 0.6
_HAND_EYE = 3
_NAMED_IMAGES = 12
_NOISE_RATIO = 2.0


@dataclass(frozen=True)
class Need:
    """One thing that is missing: for which `command`, whether the command cannot do without, and what to do.

    `in_verdict`: so important that the verdict states it although the command runs without it. `is_mistake`: data are
    wrong or implausible, not missing. `is_doubt`: wrong rows are named or the recording as a whole is in doubt, so that
    it is not right as it is.
    """

    command: str
    is_required: bool
    what: str
    action: str
    in_verdict: bool = False
    is_mistake: bool = False
    is_doubt: bool = False

    @property
    def sentence(self) -> str:
        """Missing data and what to do."""
        return f"{self.what[:1].upper()}{self.what[1:]}; {self.action}."

    def as_json(self) -> dict:
        """The entry under `missing`."""
        return {
            "command": self.command,
            "required": self.is_required,
            "what": self.what,
            "action": self.action,
            "mistake": self.is_mistake,
        }


def needs_of(
    recording: Recording, coverage: Coverage, repeats: Repeats, images: ImageCoverage | None
) -> tuple[Need, ...]:
    """All needs, those that a command cannot do without first."""
    found: list[Need] = []
    if recording.measures == "target-pose":
        found += _target_needs(recording, coverage)
    elif KINDS[recording.measures].images:
        found += _image_needs(recording, images)
        found += _hand_eye_needs(recording, coverage)
    else:
        found += _calibration_needs(recording, coverage)
        found += _noise_needs(recording, repeats)
        found += _diagnosis_needs(recording)
    return tuple(sorted(found, key=lambda need: not need.is_required))


def plausibility_needs(hand_eye) -> Iterator[Need]:
    """Mistakes in a hand-eye recording; hand_eye: `HandEyePlausibility`."""
    for statement, action, is_certain in hand_eye.findings:
        yield Need("handeye", is_certain, statement, action, is_mistake=is_certain)


def sample_needs(recording: Recording) -> Iterator[Need]:
    """Suspected mistakes in the samples of a robot: gross errors, exchanged rows, a moved instrument, ..."""
    if KINDS[recording.measures].images or not joint_columns(recording.columns):
        return
    robot = load_robot(recording.robot, f"robot of {recording.name}")
    try:
        found = check_plausibility(robot, samples_of(recording))
    except (np.linalg.LinAlgError, InputError, ValueError):
        return  # no fit is possible: other needs say why
    has_far_geometry = find_far_geometry(robot, recording) is not None  # a need of its own
    for suspicion in found:
        is_far_geometry = suspicion.cause in (CAUSE, OTHER_ROBOT) and not suspicion.certain
        if not (is_far_geometry and has_far_geometry):
            statement, action = _statement_and_action(suspicion.sentence)
            is_doubt = suspicion.is_doubt
            yield Need("calibrate", suspicion.certain, statement, action, False, True, is_doubt)


def _statement_and_action(sentence: str) -> tuple[str, str]:
    """A sentence "what was found; what to do." in its two parts."""
    statement, _, action = sentence.rstrip().removesuffix(".").rpartition("; ")
    return (statement, action) if statement else (action, "look at these data before you calibrate")


def coverage_needs(recording: Recording) -> tuple[Need, ...]:
    """Needs from number and spread of the poses, without any fit or image; indispensable ones first.

    Raises InputError where its robot cannot be loaded.
    """
    coverage = coverage_of(recording)
    if recording.measures == "target-pose":
        found = _target_needs(recording, coverage)
    elif not KINDS[recording.measures].images:
        found = _pose_needs(recording, coverage) if coverage.joints else ()
    else:
        found = _hand_eye_needs(recording, coverage) if coverage.flange is not None else ()
    return tuple(sorted(found, key=lambda need: not need.is_required))


def _calibration_needs(recording: Recording, coverage: Coverage) -> Iterator[Need]:
    if not coverage.joints:
        statement = "joint readings (q1_deg ...) are not recorded"
        yield Need("calibrate", True, statement, "record the joint readings of every row")
        return
    yield from _pose_needs(recording, coverage)
    if len(np.unique(recording.poses)) >= _least_poses(recording, coverage):
        yield from _robot_needs(recording)
        yield from _sign_needs(recording)


def _least_poses(recording: Recording, coverage: Coverage) -> int:
    """Poses that give as many equations as robot, base and tool have unknowns."""
    return int(np.ceil(_unknowns(coverage) / _COMPONENTS[recording.measures]))


def _unknowns(coverage: Coverage) -> int:
    return 4 * len(coverage.joints) + 12


def _pose_needs(recording: Recording, coverage: Coverage) -> Iterator[Need]:
    """Too few poses, joints that hardly move, and orientations that hardly change."""
    poses = len(np.unique(recording.poses))
    min_poses = _least_poses(recording, coverage)
    if poses < min_poses:
        unknown = _unknowns(coverage)
        statement = f"{poses} poses give fewer equations than the about {unknown} unknowns of robot, base and tool"
        action = f"measure {2 * min_poses} poses or more, at the least {min_poses}"
        yield Need("calibrate", True, statement, action)
    elif poses < 2 * min_poses:
        statement = f"{poses} poses leave little for held-out tests"
        yield Need("calibrate", False, statement, f"measure {2 * min_poses} poses or more")
    passive = _moved_by_others(recording)
    for joint in coverage.joints:
        if joint.extent >= _MIN_EXTENT or joint_number(joint.name) not in passive:
            yield from _joint_needs(joint)
    if coverage.spread_deg < _SMALL_SPREAD_DEG:
        spread = f"{coverage.spread_deg:.1f} deg RMS"
        statement = f"the flange keeps its orientation to {spread}: base and tool are confounded"
        yield Need("calibrate", False, statement, "add poses with other orientations")


def _moved_by_others(recording: Recording) -> set[int]:
    """Numbers of the joints that a coupling moves with the readings of others, such as those of a parallelogram."""
    mixing = load_robot(recording.robot, f"robot of {recording.name}").mixing
    others = np.abs(mixing) * ~np.eye(*mixing.shape, dtype=bool)
    return set((np.flatnonzero(others.any(1)) + 1).tolist())


def _robot_needs(recording: Recording) -> Iterator[Need]:
    """A robot file whose lengths are far from those of the arm that was measured."""
    robot = load_robot(recording.robot, f"robot of {recording.name}")
    found = find_far_geometry(robot, recording)
    if found is not None:
        yield Need("calibrate", False, found.what, found.action, True, is_doubt=True)


def _sign_needs(recording: Recording) -> Iterator[Need]:
    """Joints whose sign the measurements do not test, because they hardly move the measured point."""
    robot = load_robot(recording.robot, f"robot of {recording.name}")
    try:
        found = untested_signs(robot, samples_of(recording))
    except (np.linalg.LinAlgError, InputError, ValueError):
        return  # no fit is possible: other needs say why
    for suspicion in found:
        fits = f"{fit_words(suspicion.recorded)} as recorded, {fit_words(suspicion.fit)} with the opposite sign"
        names = sorted(suspicion.correction.touches)
        if len(names) > 1:
            statement = (
                f"the signs of columns {', '.join(names)} are not tested: the data fit as well with the opposite sign "
                f"of all of them (fit: {fits})"
            )
            action = (
                "move each joint alone and compare the sense of its readings with the robot file"
            )
        else:
            statement = (
                f"column {names[0]} moves the measured point too little for its sign to be tested "
                f"(fit: {fits})"
            )
            number = joint_number(names[0])
            action = f"check the sign of joint {number}, or measure a point away from its axis"
        yield Need("calibrate", False, statement, action)


def _joint_needs(joint) -> Iterator[Need]:
    unit = joint.name.rpartition("_")[2]
    if joint.extent < _MIN_EXTENT:
        statement = (
            f"{joint.name} does not move, so that no parameter of this joint is identifiable"
        )
        yield Need("calibrate", False, statement, "add poses that move it")
        return
    small = joint.extent < (_SMALL_MM if unit == "mm" else _SMALL_DEG)
    if small or (joint.share < _SMALL_SHARE and joint.extent < _MODERATE):
        if np.isfinite(joint.share):
            share = f", {100 * joint.share:.0f} % of its limits"
        else:
            share = ""
        statement = f"{joint.name} moves over {joint.extent:.3g} {unit} only{share}"
        yield Need(
            "calibrate",
            False,
            statement,
            "add poses near its ends, else the result holds in this range only",
        )


def _noise_needs(recording: Recording, repeats: Repeats) -> Iterator[Need]:
    if not repeats.groups:
        statement = "no pose is measured twice, so that noise and model errors cannot be separated"
        if recording.measures == "ball-surface":
            statement += " (the points of a scan show their own noise, not that of the arm's poses)"
        yield Need(
            "diagnose", False, statement, "measure some poses two or three times (column repeat)"
        )
        return
    stated = recording.sigma
    if stated is None or not np.isfinite(repeats.noise_mm) or repeats.noise_mm == 0:
        return
    ratio = float(np.median(stated)) / repeats.noise_mm
    if not 1 / _NOISE_RATIO < ratio < _NOISE_RATIO:
        statement = (
            f"the stated sigma is {ratio:.2g} times the {repeats.noise_mm:.3g} mm that repeats show"
        )
        yield Need("calibrate", False, statement, "correct sigma_mm or remove it")


def _diagnosis_needs(recording: Recording) -> Iterator[Need]:
    columns = recording.columns
    load = columns.get("payload_kg")
    if load is None or np.ptp(load) == 0:
        statement = "one payload only: compliance is seen through the arm's own weight"
        yield Need(
            "diagnose",
            False,
            statement,
            "measure some poses with a second load (column payload_kg)",
        )
    kinds = {Covariate.of(name).kind for name in columns}
    if "approach" not in kinds:
        statement = "directions of approach are not recorded: backlash cannot be tested directly"
        yield Need(
            "diagnose", False, statement, "reach poses from both sides and record approach1 ..."
        )
    if "temperature" not in kinds:
        statement = "no temperature: thermal growth can only be described as drift"
        yield Need("diagnose", False, statement, "record temperature_c")
    if "time_s" not in columns:
        statement = "no time: drift is tested by the number of the row"
        yield Need("diagnose", False, statement, "record time_s")
    if recording.robot and joint_columns(columns):
        robot = load_robot(recording.robot, f"robot of {recording.name}")
        if not robot.mass.any():
            statement = "the robot file holds no masses: compliance is found up to them"
            yield Need(
                "diagnose", False, statement, "add mass_kg and com_mm to the joints of robot.toml"
            )


def _image_needs(recording: Recording, images: ImageCoverage) -> Iterator[Need]:
    command = "camera" if recording.measures == "board-images" else "scanner"
    if images.found < _LEAST_IMAGES:
        why = f" ({images.rejected[0][1]})" if images.rejected else ""
        statement = f"the board is found in {images.found} images{why}"
        action = f"take {_FEW_IMAGES} images or more, and check [board]"
        yield Need(command, True, statement, action)
    elif images.found < _FEW_IMAGES:
        statement = f"the board is found in {images.found} images"
        yield Need(command, False, statement, f"take {_FEW_IMAGES} or more, tilted by 20 to 45 deg")
    if images.found >= _LEAST_IMAGES and images.rejected:
        count = len(images.rejected)
        reasons = [f"{image}: {why}" for image, why in images.rejected[:_NAMED_IMAGES]]
        if count > _NAMED_IMAGES:
            unlisted = [f"and {count - _NAMED_IMAGES} more"]
        else:
            unlisted = []
        subject = "1 image is" if count == 1 else f"{count} images are"
        statement = f"{subject} not usable: {' | '.join([*reasons, *unlisted])}"
        yield Need(
            command, False, statement, "look at these images, and take them again or leave them out"
        )
    if images.found and images.share_of_field < _FIELD:
        share = f"{100 * images.share_of_field:.0f} %"
        statement = f"corners cover {share} of the field, so that distortion is extrapolated"
        yield Need(command, False, statement, "move the board into the corners of the image")
    if recording.measures == "scan-images" and not images.roles.get("board-laser"):
        statement = "no images of the board with the laser (role board-laser)"
        yield Need("scanner", True, statement, "add them for eight board poses or more")
    if recording.measures == "scan-images" and not images.roles.get("scan"):
        yield Need("scan", True, "no images of scans (role scan)", "add a scan")


def _target_needs(recording: Recording, coverage: Coverage) -> Iterator[Need]:
    if recording.n < _FEW_IMAGES:
        statement = f"{recording.n} poses of the target"
        yield Need(
            "handeye", recording.n < _HAND_EYE, statement, f"measure {_FEW_IMAGES} poses or more"
        )
    if coverage.spread_deg < _SMALL_SPREAD_DEG:
        yield _small_rotations(coverage)


def _small_rotations(coverage: Coverage) -> Need:
    statement = f"the flange keeps its orientation to {coverage.spread_deg:.1f} deg RMS"
    return Need(
        "handeye", False, statement, "rotate the flange by 30 deg and more about different axes"
    )


def _hand_eye_needs(recording: Recording, coverage: Coverage) -> Iterator[Need]:
    if recording.measures != "board-images":
        return
    linked = sum("sample" in row for row in recording.images)
    if coverage.flange is None or not linked:
        statement = "images have no flange poses or joint readings"
        yield Need(
            "handeye", True, statement, "add samples.csv, and the column sample to images.csv"
        )
    elif linked < _HAND_EYE:
        yield Need(
            "handeye", True, f"{linked} images have a pose", f"add poses for {_FEW_IMAGES} images"
        )
    elif coverage.spread_deg < _SMALL_SPREAD_DEG:
        yield _small_rotations(coverage)
