"""One judgement of a recording: can the command that it is meant for do its work, and what would improve it?"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from datasets.recording import Recording
from datasets.samples.columns import KINDS
from workbench.fitting.row_order import without_sorted_rows
from workbench.recordings.inspection.coverage import (
    Coverage,
    ImageCoverage,
    coverage_of,
    image_coverage,
)
from workbench.recordings.inspection.hand_eye import (
    HandEyePlausibility,
    inspect_hand_eye,
    inspect_target_poses,
)
from workbench.recordings.inspection.needs import (
    Need,
    needs_of,
    plausibility_needs,
    sample_needs,
)
from workbench.recordings.inspection.repeats import Repeats, repeats_of

_JOBS = {"board-images": "camera", "scan-images": "scanner"}


@dataclass(frozen=True)
class Inspection:
    """Everything that is known of a recording without a fit."""

    recording: Recording
    coverage: Coverage
    repeats: Repeats
    images: ImageCoverage | None
    needs: tuple[Need, ...]
    hand_eye: HandEyePlausibility = HandEyePlausibility(())

    @property
    def job(self) -> str:
        """The command that the recording is meant for."""
        if self.recording.measures == "target-pose":
            return "handeye"
        if self.recording.measures == "board-images" and self._has_poses:
            return "handeye"
        if not self.coverage.joints and self.coverage.flange is not None:
            return "handeye"  # clouds or profiles of a ball at flange poses
        return _JOBS.get(self.recording.measures, "calibrate")

    @property
    def _has_poses(self) -> bool:
        """Whether images are linked to flange poses or joint readings, so that the recording is one of a hand-eye."""
        linked = any("sample" in row for row in self.recording.images)
        return linked and self.coverage.flange is not None

    @property
    def is_sufficient(self) -> bool:
        """Whether that command has what it cannot do without, and nothing says that the data are wrong."""
        return not self._required and not self._wrong_data

    @property
    def _required(self) -> list[Need]:
        """Missing data for the command; hand-eye requires the images of a camera calibration."""
        commands = ("handeye", "camera") if self.job == "handeye" else (self.job,)
        return [need for need in self.needs if need.is_required and need.command in commands]

    @property
    def _wrong_data(self) -> list[Need]:
        """Wrong rows, and what puts the recording as a whole in doubt."""
        return [need for need in self.needs if need.is_doubt and need.command == self.job]

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        required = self._required
        if required:
            first = required[0]
            verdict = "Not right" if first.is_mistake else "Not enough"
            return f"{verdict} for `workbench {self.job}`: {first.what}; {first.action}."
        mistakes = [need for need in self.needs if need.is_mistake]
        count = sum(not need.is_mistake for need in self.needs)
        noun = "remark says" if count == 1 else "remarks say"
        remarks = f" {count} {noun} what would improve the result." if count else ""
        stated = "".join(
            f" But {need.what}; {need.action}." for need in self.needs if need.in_verdict
        )
        if mistakes:
            first = next((need for need in mistakes if need.is_doubt), mistakes[0])
            stated = f" First look at what may be wrong: {first.what}; {first.action}.{stated}"
        if self._wrong_data:
            return f"Not right as it is for `workbench {self.job}`.{stated}{remarks}"
        return f"Enough for `workbench {self.job}`.{stated}{remarks}"

    def as_json(self) -> dict:
        """The answer of `workbench check`."""
        recording = self.recording
        poses = len(np.unique(recording.poses)) if recording.n else 0
        return {
            "measures": recording.measures,
            "samples": recording.n,
            "poses": poses,
            "coverage": self.coverage.as_json(),
            "images": None if self.images is None else self.images.as_json(),
            "repeats": self.repeats.as_json(),
            "hand_eye": self.hand_eye.as_json(),
            "noise_from_repeats_mm": self.repeats.noise_mm,
            "sigma_mm": None if recording.sigma is None else float(np.median(recording.sigma)),
            "missing": [need.as_json() for need in self.needs],
            "warnings": list(recording.warnings),
            "verdict": {
                "pass": self.is_sufficient,
                "tolerance": None,
                "residual_over_noise": None,
                "sentence": self.sentence,
            },
        }


def inspect_recording(
    recording: Recording, progress: Callable[[str], None] = lambda text: None
) -> Inspection:
    """Coverage, repeats and needs of a recording of any kind. Raises InputError where its robot cannot be loaded."""
    recording = replace(recording, warnings=without_sorted_rows(recording).warnings)
    coverage = coverage_of(recording)
    is_images = KINDS[recording.measures].images
    nothing = Repeats(0, 0, np.nan, np.nan, np.empty((3, 0)))
    is_target = recording.measures == "target-pose"
    repeats = nothing if is_images or is_target else repeats_of(recording)
    images = image_coverage(recording, progress) if is_images else None
    hand_eye = HandEyePlausibility(())
    if recording.measures == "board-images" and images is not None and images.detection:
        hand_eye = inspect_hand_eye(recording, images.detection, progress)
    elif is_target:
        hand_eye = inspect_target_poses(recording)
    needs = needs_of(recording, coverage, repeats, images)
    progress("looking for implausible rows")
    wrong = [*sample_needs(recording), *plausibility_needs(hand_eye)]
    needs = tuple(sorted([*wrong, *needs], key=lambda need: not need.is_required))
    return Inspection(recording, coverage, repeats, images, needs, hand_eye)
