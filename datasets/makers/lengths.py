"""Recordings of lengths between two places of one reflector, realised with MuJoCo statics.

`python -m datasets.makers.lengths OUT [--pairs N] [--noise MM] [--seed N] [--reach MM] [--stiff]`.

The arm of `datasets.makers.elastic_arm`, with its length errors and its compliant joints, links and pedestal,
moves a reflector from place to place; a ball bar or an interferometer measures the distance of two places.
The pose of the base is unknown.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from datasets.makers import elastic_arm, folder
from datasets.makers.mujoco_arm import reflector_points, static_equilibria

REFLECTOR = (35.0, -20.0, 90.0)
NOISE_MM = 0.005
_SHARE = 0.6  # of every joint's range, about its middle
_LEAST_MM = 50.0  # two places nearer than this are no bar's ends
_TRIES = 20


def lengths(
    pairs: int = 250,
    seed: int = 1,
    noise_mm: float = NOISE_MM,
    reach_mm: float = 1e4,
    stiff: bool = False,
) -> folder.Made:
    """`pairs` lengths of 50 mm to `reach_mm`, each with 1 sigma `noise_mm`; stiff: a rigid arm.

    Raises ValueError where too few of the poses tried lie so near to one another.
    """
    rng = np.random.default_rng(seed)
    arm = elastic_arm.true_arm(rng)
    if stiff:
        arm = replace(
            arm, joint_compliance=0.0, link_compliance=0.0, pedestal_compliance=(0.0, 0.0)
        )
    joints_deg = _pairs(rng, arm, pairs, reach_mm)
    places = _places(arm, joints_deg)
    measured = np.linalg.norm(places[0::2] - places[1::2], axis=1) + rng.normal(0, noise_mm, pairs)
    head = {"sample": np.arange(1, 2 * pairs + 1), "pair": np.repeat(np.arange(1, pairs + 1), 2)}
    return folder.Made(
        measures="distance",
        title="Lengths between places of a reflector, elastic arm",
        columns=head | folder.joint_columns(joints_deg) | {"length_mm": np.repeat(measured, 2)},
        robot=elastic_arm.robot(),
        sigma_mm=noise_mm,
        source="made with MuJoCo statics by python -m datasets.makers.lengths",
        truth={"arm": arm, "reflector": REFLECTOR},
    )


def _pairs(rng, arm, pairs, reach_mm):
    """(2 pairs, J) deg: both ends of every pair, one after the other, as a controller shows them."""
    limits = np.array([row["limits_deg"] for row in elastic_arm.robot()["joint"]], float)
    middle, half = limits.mean(1), _SHARE * np.ptp(limits, axis=1) / 2
    tried = np.round(
        rng.uniform(middle - half, middle + half, (2 * _TRIES * pairs, len(limits))), 4
    )
    rigid = replace(arm, joint_compliance=0.0, link_compliance=0.0, pedestal_compliance=(0.0, 0.0))
    places = _places(rigid, tried)
    distance = np.linalg.norm(places[0::2] - places[1::2], axis=1)
    good = np.flatnonzero((distance > _LEAST_MM) & (distance < reach_mm))[:pairs]
    if len(good) < pairs:
        raise ValueError(f"only {len(good)} of the {pairs} wanted pairs lie within {reach_mm:g} mm")
    return tried.reshape(-1, 2, len(limits))[good].reshape(2 * pairs, -1)


def _places(arm, joints_deg):
    """(n, 3) mm: the reflector in the base frame."""
    return reflector_points(
        static_equilibria(arm, np.deg2rad(joints_deg)).flange, REFLECTOR, np.eye(4)
    )


def main() -> None:
    """Write a folder."""
    import datasets

    parser = argparse.ArgumentParser(
        description="Make a recording of lengths between places of a reflector."
    )
    parser.add_argument("out")
    parser.add_argument("--pairs", type=int, default=250)
    parser.add_argument("--noise", type=float, default=NOISE_MM, metavar="MM")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--reach",
        type=float,
        default=1e4,
        metavar="MM",
        help="longest length, such as a ball bar's",
    )
    parser.add_argument("--stiff", action="store_true", help="a rigid arm")
    args = parser.parse_args()
    made = lengths(args.pairs, args.seed, args.noise, args.reach, args.stiff)
    datasets.write(made.recording(), args.out)


if __name__ == "__main__":
    main()
