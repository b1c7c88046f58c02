"""Suspicion about a recording: one sentence, its certainty, and the cause in one word."""

from collections.abc import Mapping
from dataclasses import dataclass, field

POINT_ROUNDING = "point-rounding"
HARMLESS_TO_THE_FIT = ("blunders", "sigma", "dimensions", POINT_ROUNDING)
"""Causes that leave the fit right. Faulty single rows are left out of it, and what stays is compared with the noise; a
wrong statement of the noise changes uncertainties, not the fit; wrong lengths of the robot file are estimated; rounding
of measured values is noise of a known size."""


@dataclass(frozen=True)
class Suspicion:
    """One possible mistake in a recording.

    `sentence`: what was found, why it matters and what to do.
    `certain`: True where the recorded data cannot be right: one correction fits position and orientation as
    well as plausible geometry errors allow, and the data as recorded do not. A calibration then refuses.
    `cause`: the kind of mistake as one term, for example "joint-sign" or "rows-shifted". `alternatives`: causes that
    the sentence names as equally good explanations. `rows`: indices of the rows that the sentence names, () where it
    is about all rows. `instant`: sample numbers before and after a jump; None where nothing jumps. `robot_keys`:
    keys of robot.toml that explain the recording and replace those of the file, with the words `use` for them; empty
    where the sentence is about something else. `is_explanation`: one correction of the data explains their misfit.
    """

    sentence: str
    certain: bool
    cause: str = ""
    alternatives: tuple[str, ...] = ()
    rows: tuple[int, ...] = ()
    instant: tuple[int, int] | None = None
    robot_keys: Mapping = field(default_factory=dict)
    use: str = ""
    is_explanation: bool = False

    @property
    def is_doubt(self) -> bool:
        """Whether rows are named as wrong, or the recording as a whole is in doubt.

        A calibration replaces the keys of the robot file that explain the recording, which leaves no doubt.
        """
        is_harmless = bool(self.robot_keys) or self.cause in HARMLESS_TO_THE_FIT
        return bool(self.rows) or not is_harmless
