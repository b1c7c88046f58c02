"""Definition of the suites: effects, sizes, world, noise, and withheld covariates."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from datasets.makers.blind.effects import library, uncatalogued
from datasets.makers.blind.scatter import Scatter
from datasets.makers.blind.workplace import Requirements

SUITES = ("clean", "library", "swallowed", "pairs", "outside", "covariate-withheld")
"""Suites that this maker draws."""


@dataclass(frozen=True)
class Question:
    """names, sizes: effects and their RMS per coordinate orthogonal to the baseline, sigma. min_sigma: smallest RMS.

    withheld: kinds of covariates that the file lacks; words: names by which an answer requests them.
    shuffled: the rows are not in order of time.
    """

    names: tuple[str, ...] = ()
    sizes: tuple[float, ...] = ()
    requirements: Requirements = Requirements()
    scatter: Scatter = Scatter()
    min_sigma: float = 0.0
    withheld: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    shuffled: bool = False

    def law(self, name: str) -> Callable:
        """The function that makes the effect of that name."""
        return (
            uncatalogued.CAUSES[name][0] if name in uncatalogued.CAUSES else library.ROWS[name].law
        )

    def one_sided(self, name: str) -> bool:
        """Whether its size is above 0."""
        return name not in uncatalogued.CAUSES and library.ROWS[name].one_sided


def asked(suite: str) -> Callable[[np.random.Generator, int], Question]:
    """The function that draws a suite's questions. Raises ValueError for a name that is none."""
    if suite not in _ASKED:
        raise ValueError(f"no suite is called {suite!r}: {', '.join(_ASKED)}")
    return _ASKED[suite]


def _clean(rng, index) -> Question:
    """No effect: with irrelevant covariates, heavy-tailed noise, a wrong sigma, or no sigma."""
    kind = index % 5
    scatter = {
        2: Scatter(degrees=float(rng.choice([4, 6, 10]))),
        3: Scatter(stated=float(np.exp(rng.uniform(np.log(0.5), np.log(2.0))))),
        4: Scatter(stated=None),
    }.get(kind, Scatter())
    need = {"time", "temperature", "payload", "approach", "speed"} if kind == 1 else set()
    return Question(
        requirements=Requirements(need=frozenset(need), elastic=bool(rng.random() < 0.15)),
        scatter=scatter,
    )


def _library(rng, index) -> Question:
    """Every effect in turn by weight; two thirds at 1 to 10 sigma, the others smaller, for the curve."""
    name = _drawn(rng, library.ROWS)
    row = library.ROWS[name]
    requirements = replace(
        row.requirements,
        elastic=row.requirements.elastic or (name not in _ELASTIC_LAWS and rng.random() < 0.15),
    )
    return Question((name,), (_size(rng, index),), requirements)


_ELASTIC_LAWS = {"joint-compliance", "link-self-weight"}


def _size(rng, index: int) -> float:
    low, high = (0.15, 1.0) if index % 3 == 2 else (1.0, 10.0)
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _absorbed(rng, index) -> Question:
    """Effects that the fit absorbs, in samples of which a fifth reveals them."""
    name = str(rng.choice(list(library.ABSORBED)))
    row = library.ROWS[name]
    requirements = replace(row.requirements, split=library.ABSORBED[name], samples=(200, 800))
    return Question(
        (name,), (float(np.exp(rng.uniform(np.log(0.5), np.log(4)))),), requirements, min_sigma=0.2
    )


def _pairs(rng, index) -> Question:
    """Two effects at once, one time in four on the same joint."""
    able = {name: row for name, row in library.ROWS.items() if name not in _ALONE}
    first, second = _drawn(rng, able), _drawn(rng, able)
    if index % 4 == 0:
        first, second = (str(x) for x in rng.choice(_ON_JOINTS, 2, replace=False))
    several = [library.ROWS[name].requirements for name in (first, second)]
    if {w.measures for w in several} - {""} and "mount-tilt" in (first, second):
        first = "joint-coupling"
    requirements = Requirements(
        measures=max(w.measures for w in several),
        need=several[0].need | several[1].need,
        elastic=any(w.elastic for w in several),
        samples=(200, 1000),
    )
    sizes = tuple(float(np.exp(rng.uniform(0, np.log(8)))) for _ in range(2))
    return Question((first, second), sizes, requirements, min_sigma=0.5)


_ALONE = {"unit-or-frame", "encoder-quantisation", "mount-tilt"}
_ON_JOINTS = (
    "transmission-harmonic",
    "joint-compliance",
    "backlash",
    "zero-shift",
    "joint-thermal-drift",
)


def _uncatalogued(rng, index) -> Question:
    """Effects outside the vocabulary."""
    name = list(uncatalogued.CAUSES)[index % len(uncatalogued.CAUSES)]
    requirements = Requirements(need=uncatalogued.CAUSES[name][1], samples=(200, 1000))
    return Question(
        (name,), (float(np.exp(rng.uniform(0, np.log(8)))),), requirements, min_sigma=0.8
    )


def _withheld(rng, index) -> Question:
    """An effect whose covariate is withheld, in shuffled rows."""
    name = list(library.WITHHELD)[index % len(library.WITHHELD)]
    kind, words = library.WITHHELD[name]
    gone = (
        (kind, "time") if kind in ("temperature", "approach") else (kind,)
    )  # time would tell what came before
    requirements = Requirements(need=frozenset({kind}), samples=(200, 1000))
    return Question(
        (name,),
        (float(np.exp(rng.uniform(0, np.log(8)))),),
        requirements,
        min_sigma=0.8,
        withheld=gone,
        words=words,
        shuffled=True,
    )


def _drawn(rng, rows) -> str:
    weights = np.array([row.weight for row in rows.values()])
    return str(rng.choice(list(rows), p=weights / weights.sum()))


_ASKED: dict[str, Callable[[np.random.Generator, int], Question]] = {
    "clean": _clean,
    "library": _library,
    "swallowed": _absorbed,
    "pairs": _pairs,
    "outside": _uncatalogued,
    "covariate-withheld": _withheld,
}
