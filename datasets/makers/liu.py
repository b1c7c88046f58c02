"""Recordings of laser beams after Liu, Shi & Ding (IEEE CYBER 2014, 365), by plain matrix products.

`python -m datasets.makers.liu OUT [--beams N] [--positions M] [--sigma MM] [--seed N]`.

A laser on the flange of an ABB IRB 120 shines along the flange's x axis. A detector is turned about
a fixed centre, so that its middle stays on a sphere; in each of M positions N beams are driven to its
middle. Centre and radius are those of the sphere nearest to the means of the paper's table 2; these means
themselves come from a solve that had failed, and eq. 7 does not converge with them as middles (two are
9 mm apart): the middles are spread evenly over the cap that faces the arm. With one
position there is no sphere: one fixed detector.

Table 3's columns run together in our copy. Its rows go theta, d, a, alpha of joint after joint, and
the column "actual" agrees with the result of the second objective in the next column: d3 -0.05 (-0.0501),
a3 -0.04 (-0.0400), d4 0.04 (0.0399), d5 0.04 (0.0430), a1 0.05 (0.0491), all certain. Taken with
less certainty: a2 -0.1 (-0.1105), d2 0.05 (printed apart). The twists of joints 1 to 4 were found as
-0.0480, -0.0494, -0.0499 and -0.0500 deg, while "-0.3" and "-0.06" stand in the column of the actual
ones of joints 3 and 4: -0.05 deg is taken for all four. The rest is 0, as printed.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.spatial.transform import Rotation

from datasets import papers
from datasets.makers import folder, poses
from datasets.makers.gubankov import geometry_of, robot_keys

_SOURCE = "made by datasets.makers.liu from the tables of IEEE CYBER 2014, 365"
_NOMINAL = (  # theta deg, a, d mm, alpha deg
    (0, 0, 290, -90),
    (-90, 270, 0, 0),
    (0, 70, 0, -90),
    (0, 0, 302, 90),
    (0, 0, 0, -90),
    (180, 0, 72, 0),
)
ERRORS = (
    (0, 0.05, 0, -0.05),
    (0, -0.1, 0.05, -0.05),
    (0, -0.04, -0.05, -0.05),
    (0, 0, 0.04, -0.05),
    (0, 0, 0.04, 0),
    (0, 0, 0, 0),
)
_LIMITS = ((-165, 165), (-110, 110), (-110, 70), (-160, 160), (-120, 120), (-400, 400))
_CAP = np.deg2rad(75)  # of the sphere, from its pole
_CONE = np.deg2rad(40)  # how far a beam may lean from the line shoulder - detector
_NEAREST_MM, _FARTHEST_MM = 120.0, 260.0  # mm between flange and detector


def sphere() -> tuple[np.ndarray, float]:
    """Centre (3,) and radius, mm, of the sphere nearest to the means of table 2."""
    means = np.array(papers.load("liu-2014")["table_2"]["means_mm"])
    system = np.column_stack([2 * means, np.ones(len(means))])
    found = np.linalg.lstsq(system, (means**2).sum(1), rcond=None)[0]
    return found[:3], float(np.sqrt(found[3] + found[:3] @ found[:3]))


def middles_on_sphere(positions: int) -> np.ndarray:
    """(M, 3) mm, evenly over the cap that faces the arm's shoulder (golden spiral)."""
    centre, radius = sphere()
    k = np.arange(positions) + 0.5
    height = 1 - (1 - np.cos(_CAP)) * k / positions
    golden_angle = np.pi * (3 - np.sqrt(5))
    angle = k * golden_angle
    ring_radius = np.sqrt(1 - height**2)
    rays = np.stack([ring_radius * np.cos(angle), ring_radius * np.sin(angle), height], 1)
    shoulder = np.array([0, 0, _NOMINAL[0][2]])
    towards_arm, _ = Rotation.align_vectors(shoulder - centre, [0, 0, 1])
    return centre + radius * towards_arm.apply(rays)


def irb120(beams: int = 6, positions: int = 7, sigma_mm: float = 0.0, seed: int = 1) -> folder.Made:
    """`beams` to each of `positions` middles of the detector; sigma_mm: 1 sigma of each coordinate aimed at."""
    rng = np.random.default_rng(seed)
    (centre, radius), middles = sphere(), middles_on_sphere(positions)
    point = np.repeat(np.arange(positions), beams)
    geometry = geometry_of(np.array(_NOMINAL, float) + ERRORS)
    targets = middles[point] + sigma_mm * rng.normal(size=(len(point), 3))
    joints = aiming(rng, geometry, targets)
    head = {
        "sample": np.arange(1, len(point) + 1),
        "point": point + 1,
        "sphere": np.ones(len(point)),
    }
    return folder.Made(
        measures="laser-spot",
        title=f"IRB 120 drives {beams} laser beams to each of {positions} places of a detector",
        columns=head | folder.joint_columns(np.rad2deg(joints)),
        robot=robot_keys("ABB IRB 120", np.array(_NOMINAL, float), _LIMITS, (1,)),
        sigma_mm=max(sigma_mm, 1e-3),
        source=_SOURCE,
        truth={"geometry": geometry, "points": middles, "centre": centre, "radius": radius},
    )


def aiming(rng, geometry: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Joint angles (n, 6) with which the beam of an arm of `geometry` passes each target (n, 3), mm, to rounding."""
    limits, joints = np.deg2rad(_LIMITS), np.full((len(targets), 6), np.nan)
    for _ in range(200):
        todo = np.flatnonzero(np.isnan(joints[:, 0]))
        if not todo.size:
            return _on_target(geometry, joints, targets)
        begin = rng.uniform(limits[:, 0], limits[:, 1], (len(todo), 6)) * [
            0.5,
            0.5,
            0.5,
            1,
            0.8,
            0.4,
        ]
        found, good = poses.inverse(geometry, _views(rng, targets[todo]), begin, limits, 30)
        joints[todo[good]] = found[good]
    raise ValueError(f"{np.isnan(joints[:, 0]).sum()} places of the detector cannot be reached")


def _views(rng, targets):
    """(n, 4, 4) flange poses whose x axis looks at the targets from the arm's side, rolled at random."""
    direction = targets - [0, 0, _NOMINAL[0][2]]
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    lean = rng.normal(size=direction.shape)
    lean = np.cross(direction, lean / np.linalg.norm(lean, axis=1, keepdims=True))
    lean = lean * _CONE * rng.uniform(0, 1, (len(direction), 1))
    beam = Rotation.from_rotvec(lean).apply(direction)
    side = np.cross(beam, rng.normal(size=beam.shape))
    side = side / np.linalg.norm(side, axis=1, keepdims=True)
    views = np.tile(np.eye(4), (len(targets), 1, 1))
    views[:, :3, :3] = np.stack([beam, side, np.cross(beam, side)], 2)
    views[:, :3, 3] = targets - rng.uniform(_NEAREST_MM, _FARTHEST_MM, (len(targets), 1)) * beam
    return views


def misses(geometry: np.ndarray, joints: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """(n, 2) mm by which each beam passes its target, in the flange's y and z."""
    flange = poses.forward_kinematics(geometry, joints)
    return np.einsum("nji,nj->ni", flange[:, :3, :3], targets - flange[:, :3, 3])[:, 1:]


def _on_target(geometry, joints, targets):
    """The smallest turns of the joints that bring each beam onto its target."""
    h = 1e-6
    for _ in range(4):
        misses_at_joints = misses(geometry, joints, targets)
        slope = np.stack(
            [
                (misses(geometry, joints + h * e, targets) - misses_at_joints) / h
                for e in np.eye(joints.shape[1])
            ],
            2,
        )
        joints = joints - np.einsum("njk,nk->nj", np.linalg.pinv(slope), misses_at_joints)
    return joints


def main() -> None:
    """Write a folder."""
    import datasets

    parser = argparse.ArgumentParser(
        description="Make a recording of laser beams through a detector's middle."
    )
    parser.add_argument("out")
    parser.add_argument("--beams", type=int, default=6)
    parser.add_argument("--positions", type=int, default=7)
    parser.add_argument("--sigma", type=float, default=0.0, metavar="MM")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    datasets.write(irb120(args.beams, args.positions, args.sigma, args.seed).recording(), args.out)


if __name__ == "__main__":
    main()
