"""One blind case, drawn from a seed: a public recording and a hash-committed truth."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from datasets.makers.blind import baseline_span, suites, workplace
from datasets.makers.blind.effects import data, uncatalogued
from datasets.makers.blind.effects.planted import Sized, sized
from datasets.makers.blind.scatter import Scatter
from datasets.makers.blind.world import Perturbation, World
from datasets.makers.mujoco_arm import StaticsError

_TRIES = 60
_HIDDEN = 0.25
"""Largest share of an absorbed effect that may remain in the fitted samples."""


@dataclass(frozen=True)
class Case:
    """A recording's columns (file units), robot and balls, and its truth; `baseline` is part of the question.

    balls: ball -> x, y, z, radius mm. sigma_mm: as stated in the file; None: not stated.
    """

    measures: str
    columns: Mapping[str, np.ndarray]
    robot: Mapping
    balls: Mapping[int, tuple]
    sigma_mm: float | None
    baseline: str
    truth: Mapping


def draw(suite: str, index: int, seed: int) -> Case:
    """Case `index` of a suite; the same for the same numbers. Raises ValueError for an unknown suite."""
    rng = np.random.default_rng([seed, sum(map(ord, suite)), index])
    asked = suites.asked(suite)
    for _ in range(_TRIES):
        question = asked(rng, index)
        try:
            world = workplace.draw(rng, question.requirements)
            found = _planted(rng, world, question)
        except (
            ValueError,
            StaticsError,
        ):  # an arm that cannot reach its workplace or cannot carry its weight
            continue
        if found is not None:
            return _case(rng, suite, index, world, question, found)
    raise ValueError(
        f"suite {suite}, case {index}: {_TRIES} tries made no case that can be measured"
    )


def _planted(rng, world: World, question) -> list[Sized] | None:
    """The effects of a question at their sizes; None if one of them is not possible."""
    base = baseline_span.basis(world)
    found = []
    for name, wanted in zip(question.names, question.sizes):
        effect = question.law(name)(rng, world)
        if effect is None:
            return None
        base_of_effect = (
            base if effect.effect != "unknown" else uncatalogued.local_basis(world, base, effect)
        )
        sign = 1.0 if question.one_sided(name) else float(rng.choice([-1, 1]))
        sized_effect = sized(world, base_of_effect, effect, wanted, sign)
        if sized_effect is None or (
            not effect.fixed and sized_effect.orthogonal_sigma < question.min_sigma
        ):
            return None
        found.append(sized_effect)
    if len({(s.planted.effect, s.planted.where) for s in found}) < len(found):
        return None
    return found if not world.part.any() or _hidden(world, found[0]) <= _HIDDEN else None


def _hidden(world: World, effect: Sized) -> float:
    """Residual effect in the samples outside the part after a fit to them, relative to the size of the effect."""
    shown = world.only(~world.part)
    change = world.measured(effect.push) - world.clean
    remaining = baseline_span.left(baseline_span.basis(shown), change[~world.part])
    return baseline_span.rms(remaining) / baseline_span.rms(change)


def _case(rng, suite, index, world: World, question, found) -> Case:
    push = sum((effect.push for effect in found), Perturbation())
    exact = world.measured(push)
    points = exact + _noise(rng, world, question.scatter, push)
    columns = _columns(world, points)
    for effect in found:
        if effect.planted.effect == "unit-or-frame":
            columns = data.garbled(columns, effect.planted.detail)
    order = _order(rng, world, question.shuffled)
    columns = {
        name: column if name == "pose" else column[order]  # poses are numbered as the file has them
        for name, column in columns.items()
        if not _left_out(name, question.withheld)
    }
    columns = {"sample": np.arange(1, world.n + 1, dtype=float)} | columns
    balls = {k + 1: (*map(float, place), 15.0) for k, place in enumerate(world.targets)}
    stated = question.scatter.stated
    truth = _truth(suite, index, world, question, found) | {
        "part": (np.flatnonzero(world.part[order]) + 1).tolist()
    }
    return Case(
        world.measures,
        columns,
        world.robot,
        balls if world.measures == "ball-centre" else {},
        None if stated is None else float(f"{world.sigma * stated:.3g}"),
        "joint-compliance" if world.elastic else "geometry",
        truth,
    )


def _order(rng, world: World, shuffled: bool) -> np.ndarray:
    """(n,) order of the rows in the file: as measured, or with shuffled poses (rows of a pose stay together)."""
    count = len(world.targets) if world.measures == "external-point" else 1
    poses = np.arange(world.n).reshape(-1, count)
    return (rng.permutation(poses) if shuffled else poses).ravel()


def _truth(suite, index, world, question, found) -> dict:
    return {
        "suite": suite,
        "index": index,
        "effects": [effect.truth() for effect in found],
        "robot": world.robot["name"],
        "measures": world.measures,
        "samples": world.n,
        "sigma_mm": world.sigma,
        "noise": question.scatter.word,
        "covariates": sorted(world.covariates),
        "withheld": question.withheld,
        "words": list(question.words),
        "split": question.requirements.split,
        "baseline": "joint-compliance" if world.elastic else "geometry",
    }


def _noise(rng, world, scatter: Scatter, push: Perturbation) -> np.ndarray:
    """(n, 3) mm of unit variance times sigma."""
    unit = rng.normal(0, 1, (world.n, 3))
    if scatter.degrees:
        unit = rng.standard_t(scatter.degrees, (world.n, 3)) / np.sqrt(
            scatter.degrees / (scatter.degrees - 2)
        )
    spread = np.broadcast_to(push.spread, world.n)
    return world.sigma * np.exp(spread)[:, None] * unit


def _columns(world: World, points) -> dict:
    columns = {f"q{k}_deg": column for k, column in enumerate(np.rad2deg(world.readings).T, 1)}
    columns |= dict(zip(("x_mm", "y_mm", "z_mm"), points.T))
    if world.measures == "ball-centre":
        columns["ball"] = world.index + 1.0
    elif len(world.targets) > 1:
        columns |= {
            "reflector": world.index + 1.0,
            "pose": np.arange(world.n) // len(world.targets) + 1.0,
        }
    return columns | dict(world.covariates)


_PREFIX = {
    "approach": "approach",
    "payload": "payload_kg",
    "temperature": "temperature",
    "speed": "qdot",
    "time": "time_s",
}


def _left_out(name: str, kinds) -> bool:
    return any(name.startswith(_PREFIX[kind]) for kind in kinds)
