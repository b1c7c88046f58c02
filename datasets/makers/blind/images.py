"""Cases of the suite "sensor": rendered recordings of a scanner with one planted effect or none."""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from datasets.makers import blind_images

_FLAWLESS = 8
"""One of this number of cases is a scanner without a planted effect."""


@dataclass(frozen=True)
class Case:
    """A case to be rendered; `found` holds its truth after the rendering."""

    suite: str
    index: int
    seed: int
    effect: str | None
    size: float
    found: dict = field(default_factory=dict)


def draw(suite: str, index: int, seed: int) -> Case:
    """Every effect in turn, at half to twice the size on a poor instrument; at intervals none."""
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
    """Render the images into a new folder, and keep their truth in `case.found`."""
    case.found.update(blind_images.make(case.seed, folder, case.effect, case.size))


def truth(case: Case, salt: str) -> str:
    """The text of the truth, after the rendering."""
    known = {
        "robot": "a scanner",
        "samples": None,
        "sigma_mm": None,
        "noise": "of images",
        "baseline": "geometry",
    }
    keys = {**known, **case.found, "suite": case.suite, "index": case.index, "salt": salt}
    return json.dumps(keys, indent=1, sort_keys=True) + "\n"


def salt(seed: int, suite: str, index: int) -> str:
    """Salt of a case, deterministic."""
    return hashlib.sha256(f"salt {seed} {suite} {index}".encode()).hexdigest()[:32]
