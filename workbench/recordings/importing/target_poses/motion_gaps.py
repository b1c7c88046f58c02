"""Questions on flange poses that nobody can answer, because the flange does not rotate enough to decide anything."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from sensors.hand_eye.motion import motion
from workbench.core.errors import InputError
from workbench.recordings.importing.interpretation.fits import CandidateFit


@contextmanager
def named_gaps(
    file: str,
    fits: Sequence[tuple[int, CandidateFit]],
    poses_of: Callable[[int], np.ndarray],
) -> Iterator[None]:
    """An error inside, that several readings fit, names the motion that is missing where the best reading shows it.

    fits: index and fit of the readings, the most probable first. poses_of: the flange poses (n, 4, 4) of a reading.
    """
    try:
        yield
    except InputError:
        best = fits[0] if fits else None
        if best is None or not best[1].is_good:
            gaps = ()
        else:
            gaps = motion(poses_of(best[0]), "in-hand").sentences
        if not gaps:
            raise
        raise InputError(
            f"{file}: expected flange poses that decide between the readings of the columns, found that {gaps[0]}."
        ) from None
