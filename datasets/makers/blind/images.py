"""Cases of the suite "sensor": rendered recordings of a scanner, one flaw or none concealed in each."""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from datasets.makers import blind_images

_FLAWLESS = 8
"""One case in so many is a scanner without a flaw."""


@dataclass(frozen=True)
class Case:
    """A case to be rendered; `told` is its truth, filled when the images are."""

    suite: str
    index: int
    seed: int
    effect: str | None
    size: float
    told: dict = field(default_factory=dict)


def draw(suite: str, index: int, seed: int) -> Case:
    """Every flaw in turn, at half to twice what a poor instrument has; and now and then none."""
    rng = np.random.default_rng([seed, 555, index])
    flaw = (
        None
        if index % _FLAWLESS == _FLAWLESS - 1
        else list(blind_images.EFFECTS)[index % _FLAWLESS]
    )
    return Case(
        suite,
        index,
        int(rng.integers(2**31)),
        flaw,
        float(np.exp(rng.uniform(np.log(0.5), np.log(2)))),
    )


def recording(case: Case, folder: Path) -> None:
    """Render the images into a new folder, and keep their truth in `case.told`."""
    case.told.update(blind_images.make(case.seed, folder, case.effect, case.size))


def truth(case: Case, salt: str) -> str:
    """The sealed text, once the images are rendered."""
    known = {
        "robot": "a scanner",
        "samples": None,
        "sigma_mm": None,
        "noise": "of images",
        "baseline": "geometry",
    }
    told = {**known, **case.told, "suite": case.suite, "index": case.index, "salt": salt}
    return json.dumps(told, indent=1, sort_keys=True) + "\n"


def salt(seed: int, suite: str, index: int) -> str:
    """The same for the same case."""
    return hashlib.sha256(f"salt {seed} {suite} {index}".encode()).hexdigest()[:32]
