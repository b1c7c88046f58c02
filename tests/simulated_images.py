"""Measurements of a sensor as they would have been with effects of chosen sizes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from workbench.core.effect import Effect
from workbench.diagnosis.scanner.sensor import SensorBench
from workbench.diagnosis.scanner.sensor_linear import acts
from workbench.jobs.sensor.chains import Chains, at_solution, measured


def solved(bench: SensorBench) -> Chains:
    """The bench's chains at the solution of its baseline: a true sensor to simulate from."""
    return at_solution(*bench.solve())


def simulated(
    chains: Chains, effects: Sequence[Effect], values: Mapping[str, float], seed: int
) -> Chains:
    """The same images with fresh Gaussian noise of the stated sigmas, and with `effects` at `values` (by key) acting.

    The chains are assumed to be true. Pixels are moved until the chain's residual, effects included, is the noise.
    """
    rng = np.random.default_rng(seed)
    parts = {}
    for name, chain in chains.parts.items():
        acting = tuple(effect for effect in effects if acts(effect, name))
        noise = rng.standard_normal((len(chain.sigma), chain.pixels.shape[1])) * chain.sigma
        parts[name] = measured(chain, acting, values, noise)
    return replace(chains, **parts)
