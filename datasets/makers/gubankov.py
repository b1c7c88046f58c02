"""Recordings of touched points after Gubankov & Yukhimets (Sensors 2022, 22, 3376), by plain matrix products.

`python -m datasets.makers.gubankov OUT [--arm rv2fb|ur10e] [--driving-error MM] [--seed N]`.

A sharp tip on the flange is driven to fixed points with many orientations; joint readings and the
number of the point are all that is kept. The arm that touches has the true parameters, the
recording's robot.toml the nominal ones. What the paper's copy lost or does not say:

- Minus signs of the Denavit-Hartenberg rows. Those of the RV-2FB are settled by the identified
  values: alpha1 is printed 89.89 with a deviation of 0.115, so -90 + 0.115, and so on; a2 is 230 - 0.4,
  as 229.61 was found. alpha5 is -90 as every wrist of this make, and moves away from zero (90.115).
  The printed sixth row and TCP put the tip at (10.209, 19.998, 179.303) before joint 6 turns where the
  truth taken here has (10.2, 20, 179.3), but only with alpha6 = -0.078 deg: the signs belong together.
  Deviations that nothing decides (alpha2, theta4, theta5, a1, a4, a5, a6, d2, d5, d6) are taken as printed.
- The UR10e has a2 and a3 negative and alpha5 = -90 deg, as its maker says; small identified entries are
  taken as printed, or with signs drawn (`signs`), since nothing decides them.
- How the arm stood. Here the tool points down, tilted by up to `tilt_deg`, with any roll that the wrist
  allows. The J that the paper starts from suggests about 25 deg; the wider, the better the result,
  and 80 deg was chosen with that seen.
- The distribution of the driving error, of which only the largest is given: its length is uniform
  from 0 to that, its direction random. That leaves a J of about 8, as was published; errors uniform
  within a ball would leave 15.
"""

from __future__ import annotations

import argparse
import math

import numpy as np

from datasets import papers
from datasets.makers import folder, poses

_SOURCE = "made by datasets.makers.gubankov from the tables of Sensors 2022, 22, 3376; base frame: joint 1's axis"
_RV_NOMINAL = [
    [1, 1, 1, -1],
    [-1, 1, 1, 1],
    [-1, 1, 1, -1],
    [1, 1, 1, 1],
    [1, 1, 1, -1],
    [1, 1, 1, 1],
]
_RV_DEVIATION = [
    [1, 1, 1, 1],
    [1, -1, 1, 1],
    [1, 1, 1, 1],
    [1, 1, 1, 1],
    [1, 1, 1, -1],
    [1, 1, 1, 1],
]
_RV_LIMITS = ((-240, 240), (-120, 120), (0, 160), (-200, 200), (-120, 120), (-360, 360))
_UR_SIGNS = [[1, 1, 1, 1], [1, -1, 1, 1], [1, -1, 1, 1], [1, 1, 1, 1], [1, 1, 1, -1], [1, 1, 1, 1]]
_UR_POINTS = ((-600.0, -300.0, 150.0), (-700.0, 250.0, 200.0), (-350.0, 600.0, 100.0))
_UR_TIP = (3.0, -2.0, 150.0)  # not in the paper
# Where the tool points straight down in front of the arm, deg.
_START = {"rv2fb": (0, 20, 110, 0, 60, 0), "ur10e": (0, -75, 110, -125, -90, 0)}
_LENGTH_OF_SIGMA = (
    3.0  # a length uniform up to m has a mean square of m^2 / 3, shared by three coordinates
)
_EXACT_MM = 1e-3  # what is stated of touches without error


def rv2fb(driving_error_mm: float = 0.0, seed: int = 1, tilt_deg: float = 80.0) -> folder.Made:
    """Series of 21, 21, 18 and 11 touches of the paper's four points by a Mitsubishi RV-2FB (section 5)."""
    table = papers.load("gubankov-2022")["rv2fb"]
    nominal = np.array(table["nominal_magnitude"], float) * _RV_NOMINAL
    true = nominal + np.array(table["deviation_magnitude"]) * _RV_DEVIATION
    robot = robot_keys("Mitsubishi RV-2FB", nominal, _RV_LIMITS, (1,))
    return _made(
        "rv2fb",
        robot,
        true,
        table["tcp_mm"],
        table["points_mm"],
        table["touches"],
        driving_error_mm,
        seed,
        tilt_deg,
    )


def ur10e(
    driving_error_mm: float = 0.0, seed: int = 1, tilt_deg: float = 80.0, signs: int | None = None
) -> folder.Made:
    """Three series of 21 touches by a UR10e whose true rows are those that the paper identified (section 6).

    signs: None takes small entries as printed; a number seeds their drawing.
    """
    table = papers.load("gubankov-2022")["ur10e"]
    nominal = np.array(table["nominal_magnitude"], float) * _UR_SIGNS
    found = np.array(table["identified_magnitude"], float)
    small = np.array(table["nominal_magnitude"]) == 0
    drawn = (
        np.ones_like(found)
        if signs is None
        else np.random.default_rng(signs).choice([-1.0, 1.0], found.shape)
    )
    true = found * np.where(small, drawn, _UR_SIGNS)
    robot = robot_keys("Universal Robots UR10e", nominal, ((-360, 360),) * 6, (1, 2))
    return _made(
        "ur10e",
        robot,
        true,
        _UR_TIP,
        _UR_POINTS,
        table["touches"],
        driving_error_mm,
        seed,
        tilt_deg,
    )


def robot_keys(name: str, rows: np.ndarray, limits, parallel) -> dict:
    """robot.toml as a mapping; rows (6, 4) theta deg, a, d mm, alpha deg; `parallel`: rows with Hayati's beta."""
    joints = [
        {
            "theta_deg": theta,
            "d_mm": d,
            "a_mm": a,
            "alpha_deg": alpha,
            "hayati": k in parallel,
            "limits_deg": limit,
        }
        for k, ((theta, a, d, alpha), limit) in enumerate(
            zip(rows.tolist(), np.array(limits, float).tolist())
        )
    ]
    return {
        "name": name,
        "convention": "distal",
        "gravity": [0.0, 0.0, -1.0],
        "source": "nominal rows of Gubankov & Yukhimets, Sensors 2022, 22, 3376",
        "joint": joints,
    }


def geometry_of(rows: np.ndarray) -> np.ndarray:
    """(6, 5) theta, d, a, alpha, beta in rad and mm of the paper's (6, 4) theta deg, a, d, alpha deg."""
    theta, a, d, alpha = np.asarray(rows, float).T
    return np.column_stack([np.deg2rad(theta), d, a, np.deg2rad(alpha), np.zeros(len(theta))])


def _made(arm, robot, true, tip, points, touches, driving_error, seed, tilt_deg) -> folder.Made:
    rng = np.random.default_rng(seed)
    point = np.repeat(np.arange(len(points)), touches)
    centres = np.array(points, float)[point]
    stray = driving_errors(rng, len(point), driving_error)
    geometry, tip = geometry_of(true), np.array(tip, float)
    limits = np.deg2rad([row["limits_deg"] for row in robot["joint"]])
    start = np.deg2rad(_START[arm])
    joints = touching(rng, geometry, limits, tip, centres + stray, start, np.deg2rad(tilt_deg))
    head = {"sample": np.arange(1, len(point) + 1), "point": point + 1}
    return folder.Made(
        measures="touch-point",
        title=f"{robot['name']} touches {len(points)} points, driven to within {driving_error:g} mm",
        columns=head | folder.joint_columns(np.rad2deg(joints)),
        robot=robot,
        sigma_mm=max(driving_error / _LENGTH_OF_SIGMA, _EXACT_MM),
        source=_SOURCE,
        truth={
            "geometry": geometry,
            "tip": tip,
            "points": np.array(points, float),
            "start": start,
            "limits": limits,
        },
    )


def driving_errors(rng: np.random.Generator, n: int, largest_mm: float) -> np.ndarray:
    """(n, 3) mm: random directions, lengths uniform up to the largest."""
    way = rng.normal(size=(n, 3))
    return way / np.linalg.norm(way, axis=1, keepdims=True) * rng.uniform(0, largest_mm, (n, 1))


def touching(rng, geometry, limits, tip, targets, start, tilt: float) -> np.ndarray:
    """Joint angles (n, 6) with which a true arm's tip is on each target (n, 3), mm, to rounding.

    The tool points down, tilted by up to `tilt` rad, and rolls as far as it can. Raises ValueError
    where a target cannot be reached.
    """
    joints = np.full((len(targets), len(start)), np.nan)
    for _ in range(40):
        todo = np.flatnonzero(np.isnan(joints[:, 0]))
        if not todo.size:
            return _on_target(geometry, tip, joints, targets)
        flange = np.tile(np.eye(4), (len(todo), 1, 1))
        flange[:, :3, :3] = poses.looking_down(rng, len(todo), tilt, math.pi)
        flange[:, :3, 3] = targets[todo] - flange[:, :3, :3] @ tip
        begin = start + rng.uniform(-0.4, 0.4, (len(todo), len(start)))
        begin[:, 0] += _heading(geometry, start, targets[todo])
        found, good = poses.inverse(geometry, flange, begin, limits)
        joints[todo[good]] = found[good]
    raise ValueError(
        f"{np.isnan(joints[:, 0]).sum()} targets cannot be reached with the tool pointing down"
    )


def _heading(geometry, start, targets):
    """(n,) by how much joint 1 has to turn from the start posture to face each target."""
    start_point = poses.forward_kinematics(geometry, np.array(start)[None])[0, :2, 3]
    return np.arctan2(targets[:, 1], targets[:, 0]) - math.atan2(start_point[1], start_point[0])


def tips(geometry: np.ndarray, tip: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """(n, 3) mm where the tip of an arm of `geometry` (6, 5) stands at joint angles (n, 6), base frame."""
    flange = poses.forward_kinematics(geometry, joints)
    return flange[:, :3, :3] @ tip + flange[:, :3, 3]


def _on_target(geometry, tip, joints, targets):
    """The smallest turns of the joints that bring each tip onto its target."""
    h = 1e-6
    for _ in range(4):
        tips_at_joints = tips(geometry, tip, joints)
        slope = np.stack(
            [
                (tips(geometry, tip, joints + h * e) - tips_at_joints) / h
                for e in np.eye(joints.shape[1])
            ],
            2,
        )
        joints = joints + np.einsum("njk,nk->nj", np.linalg.pinv(slope), targets - tips_at_joints)
    return joints


def unseen(made: folder.Made, n: int = 500, seed: int = 99, tilt_deg: float = 80.0) -> np.ndarray:
    """(n, 6) joint angles whose tip is somewhere in the zone of the touched points, at none of them.

    The zone: as far from the base's axis as the touched points, all around where they are, within 60 mm of
    their heights, with the same tilts.
    """
    rng, truth = np.random.default_rng(seed), made.truth
    azimuths, reach = np.arctan2(*truth["points"].T[1::-1]), np.hypot(*truth["points"].T[:2])
    angle = rng.choice(azimuths, n) + rng.uniform(-0.6, 0.6, n)
    distance = rng.uniform(reach.min() - 20, reach.max(), n)
    height = rng.uniform(truth["points"][:, 2].min() - 60, truth["points"][:, 2].max() + 60, n)
    targets = np.column_stack([distance * np.cos(angle), distance * np.sin(angle), height])
    limits, start = truth["limits"], truth["start"]
    return touching(
        rng, truth["geometry"], limits, truth["tip"], targets, start, np.deg2rad(tilt_deg)
    )


def main() -> None:
    """Write a folder."""
    import datasets

    parser = argparse.ArgumentParser(description="Make a recording of touched points.")
    parser.add_argument("out")
    parser.add_argument("--arm", choices=("rv2fb", "ur10e"), default="rv2fb")
    parser.add_argument("--driving-error", type=float, default=0.0, metavar="MM")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    made = {"rv2fb": rv2fb, "ur10e": ur10e}[args.arm](args.driving_error, args.seed)
    datasets.write(made.recording(), args.out)


if __name__ == "__main__":
    main()
