"""Noise model of a case."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Scatter:
    """degrees: of freedom of Student's t, 0 for Gaussian noise; stated: the file's sigma over the true one, or None."""

    degrees: float = 0.0
    stated: float | None = 1.0

    @property
    def word(self) -> str:
        """Name in the truth file."""
        tails = "heavy-tailed" if self.degrees else "Gaussian"
        stated = (
            "no sigma stated"
            if self.stated is None
            else ""
            if self.stated == 1
            else "wrong sigma stated"
        )
        return ", ".join(filter(None, (tails, stated)))
