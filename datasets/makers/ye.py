"""Recordings of Ye et al.'s robot (Sensors 2024, 24, 2559), realised with MuJoCo statics.

`python -m datasets.makers.ye OUT [--experiment 1|2] [--wide|--cell|--anywhere] [--samples N] [--noise MM] [--seed N]`.

What the paper identified (Tables 3, 4 and 6, 7) is taken as the truth; the
nominal robot.toml has the data-sheet values. The law of the paper is linear in
torques, and MuJoCo gets masses and springs that make those torques:

- The load: F = 10 N hangs at the sensor (or reflector) origin, eq. 18-24. lambda
  (1e-3 rad per metre of lever, eq. 23) becomes lambda 1e-3 / F rad/(N m).
- The links, eq. 25: s1 = (G2 A2 + G3 L2) / F and s2 = G3 A3 / F in mm. With the
  printed values link 2's centre of mass lies behind its own axis; only the two
  moments matter. Centres of mass lie along x2 and x3, so the torques are
  F (s1 sin q2 + s2 sin(q2 - q3)) at joint 2 and -F s2 sin(q2 - q3) at joint 3.
  The paper prints + at joint 3; with its own alpha2 = 180 deg, axis 3 points
  against axis 2, and gravity makes it minus.
- Transmission, eq. 16-17: k0, ka, kb in 1e-3 rad on the readings of joints 1-3.

Readings are the Denavit-Hartenberg joint angles; q3 is the angle between links
2 and 3, so the controller's coupling (J3 = q3 - q2) does not appear. lambda of
joint 1 is applied but has nothing to act on under vertical gravity; lambda of
joint 6 is negative as printed. Base at the height of joint 2: d1 = 0.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.makers import folder, poses
from datasets.makers.mujoco_arm import (
    STANDARD_GRAVITY,
    Arm,
    Harmonic,
    arm_from_robot,
    ball_points,
    drive_errors,
    pose,
    reflector_points,
    static_equilibria,
)

LOAD_N = 10.0
_G2_N, _G3_N = 40.0, 50.0  # any two weights do; the lever arms follow from s1 and s2
_START = np.deg2rad([0, 10, -15, 0, -75, 0])


class Table(NamedTuple):
    """Results of one experiment as printed in the paper, in its units."""

    user: tuple  # T_B_U: xyz mm, (r, w, p) deg
    tool: tuple  # T_C_G, the same
    mdh: tuple  # rows theta deg, d mm, a mm, alpha deg of joints 1-5
    k0: tuple  # 1e-3 rad, joints 1-3, as the rest
    ka1: tuple
    ka2: tuple
    kb1: tuple
    kb2: tuple
    compliance: tuple  # 1e-3 rad per metre of the load's lever, joints 1-6
    s1_mm: float
    s2_mm: float


FIRST = Table(  # Tables 3 and 4
    user=((500.580, 298.611, 2638.660), (-1.815, -170.153, 98.596)),
    tool=((7.096, 0.355, -348.800), (0.825, -24.750, 179.425)),
    mdh=(
        (0, 0, 49.780, -89.973),
        (-90.066, -0.0206, 330.341, 179.937),
        (0.0372, 0.0106, 34.969, -90.001),
        (0.167, -335.305, -0.0286, 90.037),
        (179.720, -0.601, -0.0766, 90.103),
    ),
    k0=(0.0690, 0.250, -0.164),
    ka1=(-0.245, -0.261, -0.695),
    ka2=(-0.177, -0.272, -0.0487),
    kb1=(-0.333, -0.196, -0.610),
    kb2=(-0.0437, -0.199, -0.00706),
    compliance=(-1.159, 0.0640, 0.0582, 0.183, 0.852, -0.158),
    s1_mm=319.836,
    s2_mm=1833.495,
)
SECOND = Table(  # Tables 6 and 7; the reflector's attitude is not measured
    user=((-1105.029, -955.794, -116.344), (21.846, -0.521, 0.166)),
    tool=((44.200, -60.458, 104.009), (0, 0, 0)),
    mdh=(
        (0, 0, 50.202, -89.979),
        (-89.876, -0.0121, 330.049, 179.950),
        (-0.0293, 0.2361, 35.343, -89.973),
        (0.720, -335.152, -0.232, 90.016),
        (-179.415, -0.0786, 0.125, 90.012),
    ),
    k0=(0.158, 0.403, -0.0281),
    ka1=(-0.120, -0.0430, -0.503),
    ka2=(-0.0512, -0.0553, 0.144),
    kb1=(-0.206, 0.0217, -0.418),
    kb2=(0.0819, 0.0188, 0.183),
    compliance=(-1.289, 0.0668, 0.0522, 0.138, 0.732, -0.117),
    s1_mm=307.383,
    s2_mm=1841.103,
)


class Grid(NamedTuple):
    """Grid of the second experiment: ten positions along each axis of a box, mm, in each of seven orientations.

    x, y, z: (from, to) of the wrist in the base frame; attitudes: deg about x, y, z of the base, from
    pointing straight down; facing: joint 1 starts towards the place, which a wide box needs.
    """

    x: tuple[float, float] = (320, 510)
    y: tuple[float, float] = (-200, 200)
    z: tuple[float, float] = (60, 300)
    attitudes: tuple = (
        (0, 0, 0),
        (30, 0, 0),
        (-30, 0, 0),
        (0, 30, 0),
        (0, -25, 0),
        (25, 25, 35),
        (-25, 25, -35),
    )
    facing: bool = False


# The paper states neither box nor attitudes: its least active joint moves over about 50 deg, as in this box
NARROW = Grid()
# most of what the arm reaches with the tool nearly upright, turned about the vertical: makes the residuals of Table 8
WIDE = Grid(
    (200, 390),
    (-450, 450),
    (-250, 370),
    (
        (0, 0, 0),
        (3, 0, 60),
        (-3, 0, -60),
        (0, 3, 30),
        (0, -2.5, -30),
        (2.5, 2.5, 90),
        (-2.5, 2.5, -90),
    ),
    True,
)
CELL = Grid(
    (380, 480),
    (-60, 60),
    (80, 200),
    ((0, 0, 0), (10, 0, 0), (-10, 0, 0), (0, 10, 0), (0, -10, 0), (0, 0, 20), (0, 0, -20)),
)
BALLS = {  # Table 2
    1: (185.328, 408.400, 2303.870, 14.999),
    2: (240.396, 377.943, 2640.910, 15.002),
    3: (-196.154, 289.749, 2727.350, 15.001),
    4: (-246.181, 344.340, 2379.780, 14.998),
}
_NOMINAL = (
    (0, 0, 50, -90),
    (-90, 0, 330, 180),
    (0, 0, 35, -90),
    (0, -335, 0, 90),
    (180, 0, 0, 90),
    (0, 0, 0, 0),
)
_LIMITS = ((-170, 170), (-100, 145), (-110, 200), (-190, 190), (-125, 125), (-360, 360))


def robot(table: Table) -> dict:
    """The nominal robot.toml as a mapping, with data-sheet lengths and no link masses."""
    keys = ("theta_deg", "d_mm", "a_mm", "alpha_deg")
    rows = [
        dict(zip(keys, map(float, row))) | {"limits_deg": list(limit)}
        for row, limit in zip(_NOMINAL, _LIMITS)
    ]
    return {
        "name": "FANUC LR Mate 200iD",
        "convention": "distal",
        "gravity": [0.0, 0.0, -1.0],
        "source": "data-sheet lengths in the rows of Ye et al., Sensors 2024, 24, 2559; base at the height of "
        "joint 2, flange at the wrist; q3 is the angle between links 2 and 3, not the controller's J3",
        "payload": {"mass_kg": round(LOAD_N / STANDARD_GRAVITY, 5), "com_mm": list(table.tool[0])},
        "joint": rows,
    }


def true_arm(table: Table) -> Arm:
    """The arm whose statics follow the paper's law with the table's values."""
    geometry = np.zeros((6, 5))
    geometry[:5, :4] = np.array(table.mdh) * [np.pi / 180, 1, 1, np.pi / 180]
    a2, a3 = geometry[1:3, 2]
    lever2 = (table.s1_mm * LOAD_N - _G3_N * a2) / _G2_N
    lever3 = table.s2_mm * LOAD_N / _G3_N
    mass, com = np.zeros(6), np.zeros((6, 3))
    mass[1:3] = np.array([_G2_N, _G3_N]) / STANDARD_GRAVITY
    com[1:3, 0] = lever2 - a2, lever3 - a3  # frame k sits at the far end of link k
    return Arm(
        geometry,
        mass,
        com,
        np.eye(6),
        tool_mass=LOAD_N / STANDARD_GRAVITY,
        tool_com=table.tool[0],
        joint_compliance=np.array(table.compliance) * 1e-3 / LOAD_N,
    )


def harmonics(table: Table) -> list[Harmonic]:
    """Eq. 17: constant, first and second order of joints 1-3, rad."""
    orders = ((0, table.k0, (0, 0, 0)), (1, table.ka1, table.kb1), (2, table.ka2, table.kb2))
    return [
        Harmonic(joint, order, cosine * 1e-3, sine * 1e-3)
        for order, cosines, sines in orders
        for joint, (cosine, sine) in enumerate(zip(cosines, sines), 1)
    ]


def _flange(table: Table, joints_deg: np.ndarray) -> np.ndarray:
    readings = np.deg2rad(joints_deg)
    return static_equilibria(
        true_arm(table), readings, drive_errors(readings, harmonics(table))
    ).flange


def ye_first_experiment(
    n: int = 200,
    seed: int = 1,
    noise_mm: float = 0.02,
    table: Table = FIRST,
    tilt_deg: float = 50.0,
    roll_deg: float = 180.0,
) -> folder.Made:
    """Ball centres in the sensor frame: n views of the four balls from above (sec. 5.2).

    noise_mm: 1 sigma of each coordinate. tilt_deg, roll_deg: how far views are off the vertical and how
    far the sensor is turned about it, each way; the paper shows its poses in a figure only.
    """
    rng = np.random.default_rng(seed)
    artefact_base, hand_eye = pose(*table.user), pose(*table.tool)
    balls = np.array([BALLS[k][:3] for k in sorted(BALLS)])
    in_base = (balls - artefact_base[:3, 3]) @ artefact_base[:3, :3]
    nominal = arm_from_robot(robot(table)).geometry
    joints, ball = poses.scanning(
        rng,
        nominal,
        np.deg2rad(_LIMITS),
        in_base,
        hand_eye,
        n,
        _START,
        np.deg2rad(roll_deg),
        np.deg2rad(tilt_deg),
    )
    joints_deg = np.round(np.rad2deg(joints), 4)
    points = ball_points(_flange(table, joints_deg), balls[ball], artefact_base, hand_eye)
    return _made(
        "ball-centre",
        "ball centres",
        table,
        joints_deg,
        points,
        rng,
        noise_mm,
        BALLS,
        {"ball": ball + 1},
    )


def ye_second_experiment(
    n: int = 7000,
    seed: int = 1,
    noise_mm: float = 0.02,
    table: Table = SECOND,
    grid: Grid | None = NARROW,
) -> folder.Made:
    """One reflector seen by a tracker: seven attitudes on a grid of 10 x 10 x 10 places (sec. 5.3).

    n below 7000 draws that many of the 7000 without repeats; the order is
    shuffled either way. WIDE loses a few in 1000, where the wrist is stretched.
    noise_mm: 1 sigma of each coordinate. grid None: n readings anywhere in
    the middle half of all joints' limits, in any attitude. Raises ValueError
    for n above 7000 on a grid.
    """
    if grid is not None and n > 7000:
        raise ValueError(f"the grid has 7000 configurations, {n} were asked for")
    rng = np.random.default_rng(seed)
    readings = (
        _anywhere(n, rng)
        if grid is None
        else np.rad2deg(_on_grid(table, grid, rng.permutation(7000)[:n]))
    )
    joints_deg = np.round(readings, 4)
    points = reflector_points(_flange(table, joints_deg), table.tool[0], pose(*table.user))
    return _made(
        "external-point", "laser tracker", table, joints_deg, points, rng, noise_mm, {}, {}
    )


def _anywhere(n: int, rng) -> np.ndarray:
    """(n, 6) readings, deg, even over the middle half of each joint's range."""
    low, high = np.array(_LIMITS, float).T
    return (low + high) / 2 + (high - low) / 4 * rng.uniform(-1, 1, (n, 6))


def _on_grid(table: Table, grid: Grid, rows: np.ndarray) -> np.ndarray:
    """(n, 6) joint angles of the chosen rows of the grid; without those that are not found, where these are few."""
    targets = _targets(grid)[rows]
    start = np.tile(np.deg2rad([0.0, 0, 0, 0, -90, 0]), (len(rows), 1))
    if grid.facing:
        start[:, 0] = np.arctan2(targets[:, 1, 3], targets[:, 0, 3])
    geometry = arm_from_robot(robot(table)).geometry
    joints, good = poses.inverse(
        geometry, targets, start, np.deg2rad(_LIMITS), 40 if grid.facing else 25
    )
    if np.sum(~good) > (0.01 * len(rows) if grid.facing else 0):
        raise ValueError(f"{np.sum(~good)} of the grid's configurations cannot be reached")
    return joints[good]


def _targets(grid: Grid) -> np.ndarray:
    """(7000, 4, 4) flange poses: 1000 places for each of seven attitudes."""
    axes = [np.linspace(*ends, 10) for ends in (grid.x, grid.y, grid.z)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    down = np.diag([-1.0, -1.0, 1.0])  # at readings (0, 0, 0, 0, -90, 0) deg
    targets = np.tile(np.eye(4), (7, 1000, 1, 1))
    targets[..., :3, 3] = places
    targets[..., :3, :3] = (
        Rotation.from_euler("xyz", grid.attitudes, degrees=True).as_matrix() @ down
    )[:, None]
    return targets.reshape(-1, 4, 4)


def _made(measures, how, table, joints_deg, points, rng, noise_mm, balls, extra) -> folder.Made:
    points = points + rng.normal(0, noise_mm, points.shape)
    head = {"sample": np.arange(1, len(points) + 1), **extra, **folder.joint_columns(joints_deg)}
    return folder.Made(
        measures=measures,
        title=f"Ye 2024, LR Mate 200iD, {how}, simulated",
        columns=head | folder.point_columns(points),
        robot=robot(table),
        sigma_mm=noise_mm,
        balls=balls,
        source="MuJoCo statics with the values of Ye et al., Sensors 2024, 24, 2559",
        truth={"table": table, "arm": true_arm(table), "harmonics": harmonics(table)},
    )


def main() -> None:
    """Write a folder."""
    import datasets

    parser = argparse.ArgumentParser(
        description="Make a recording of one of Ye et al.'s two experiments."
    )
    parser.add_argument("out")
    parser.add_argument("--experiment", type=int, choices=(1, 2), default=1)
    parser.add_argument("--samples", type=int, help="200 and 7000 where not given")
    parser.add_argument("--noise", type=float, default=0.02, metavar="MM")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--wide", action="store_true", help="the second experiment in a wide box, see the gallery"
    )
    parser.add_argument(
        "--cell", action="store_true", help="the second experiment in a box of about 100 mm"
    )
    parser.add_argument(
        "--anywhere", action="store_true", help="the second experiment in any place and attitude"
    )
    args = parser.parse_args()
    if args.experiment == 1:
        made = ye_first_experiment(args.samples or 200, args.seed, args.noise)
    else:
        grid = WIDE if args.wide else CELL if args.cell else None if args.anywhere else NARROW
        made = ye_second_experiment(args.samples or 7000, args.seed, args.noise, grid=grid)
    datasets.write(made.recording(), args.out)


if __name__ == "__main__":
    main()
