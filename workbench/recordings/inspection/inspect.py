"""One judgement of a recording: can the command that it is meant for do its work, and what would improve it?"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from datasets.columns import KINDS
from datasets.recording import Recording
from workbench.recordings.inspection.coverage import (
    Coverage,
    ImageCoverage,
    coverage_of,
    image_coverage,
)
from workbench.recordings.inspection.needs import Need, needs_of
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

    @property
    def job(self) -> str:
        """The command that the recording is meant for."""
        return _JOBS.get(self.recording.measures, "calibrate")

    @property
    def is_sufficient(self) -> bool:
        """Whether that command has what it cannot do without."""
        return not any(need.is_required and need.command == self.job for need in self.needs)

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        required = [n for n in self.needs if n.is_required and n.command == self.job]
        if required:
            return (
                f"Not enough for `workbench {self.job}`: {required[0].what}; {required[0].action}."
            )
        count = sum(not need.is_required for need in self.needs)
        noun = "remark says" if count == 1 else "remarks say"
        more = f" {count} {noun} what would improve the result." if count else ""
        stated = "".join(
            f" But {need.what}; {need.action}." for need in self.needs if need.in_verdict
        )
        return f"Enough for `workbench {self.job}`.{stated}{more}"

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
    coverage = coverage_of(recording)
    is_images = KINDS[recording.measures].images
    nothing = Repeats(0, 0, np.nan, np.nan, np.empty((3, 0)))
    repeats = nothing if is_images else repeats_of(recording)
    images = image_coverage(recording, progress) if is_images else None
    return Inspection(
        recording, coverage, repeats, images, needs_of(recording, coverage, repeats, images)
    )
