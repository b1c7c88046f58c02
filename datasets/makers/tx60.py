"""Recordings of a Staubli TX60 after Mathematics 2023, 11, 4802, by plain matrix products.

`python -m datasets.makers.tx60 OUT [--measures np|op|full] [--planned] [--seed N] [--samples N]`.

The arm has the paper's identified errors (Table 3) as its truth and Table 2 as its nominal rows. A
tracker sees the flange's origin and its x axis (NP), its y axis (OP) or its whole attitude, all in
the robot's own base frame: base and tool are known, as in the paper. What the paper does not say:

- Which way the arm reached into the cube of 1000 mm about (550, 0, 550) mm, whose corners are out of its reach,
  and how the flange was turned. Here joints are drawn over their ranges until the flange is inside, with
  joint 1 turned back and joint 2 leaning over: so the paper's errors make about the 0.585 mm that it had before
  calibrating, where an arm that faces the cube would have had 0.9 mm.
- The noise. The AT960's +-(15 um + 6 um/m) alone leaves less than the 0.074 mm that the paper fits; 0.048 mm
  a coordinate gives that figure. What errs there (the arm's own 0.02 mm, the frames, bending) is not known.
  Axes are two places of one reflector 10 mm apart: 0.2 deg a direction leaves what the paper leaves.

Position errors in the paper are means of 3-D distances (eq. 13), not root mean squares.
"""

import argparse

import numpy as np
from scipy.spatial.transform import Rotation

from datasets import papers
from datasets.makers import folder, poses

POSITION_MM, AXIS_DEG = 0.048, 0.2
KINDS = {"np": ("partial-pose", 0), "op": ("partial-pose", 1), "full": ("external-pose", None)}
_LIMITS = (
    (-180, 180),
    (-127.5, 127.5),
    (-142.5, 142.5),
    (-270, 270),
    (-122.5, 133.5),
    (-270, 270),
)  # data sheet


def tx60(
    measures: str = "op",
    n: int = 300,
    seed: int = 1,
    planned: bool = False,
    position_mm: float = POSITION_MM,
    axis_deg: float = AXIS_DEG,
) -> folder.Made:
    """n poses in the paper's cube, seen as `measures` says: "np", "op" or "full".

    planned: the nominal arm without noise, what a plan of the measurement would hold.
    position_mm, axis_deg: 1 sigma of each coordinate, and of an axis in each of two directions. The
    poses are those of the seed, whatever is measured.
    """
    rng, kind = np.random.default_rng(seed), KINDS[measures]
    nominal, true = geometries()
    joints = in_cube(rng, nominal, n)
    joints_deg = np.round(np.rad2deg(joints), 4)
    flange = poses.forward_kinematics(nominal if planned else true, np.deg2rad(joints_deg))
    sigma = (0.0, 0.0) if planned else (position_mm, np.deg2rad(axis_deg))
    points = flange[:, :3, 3] + rng.normal(0, 1, (n, 3)) * sigma[0]
    rotations = (
        Rotation.from_rotvec(rng.normal(0, 1, (n, 3)) * sigma[1]).as_matrix() @ flange[:, :3, :3]
    )
    head = {
        "sample": np.arange(1, n + 1),
        **folder.joint_columns(joints_deg),
        **folder.point_columns(points),
    }
    return folder.Made(
        measures=kind[0],
        title=f"Staubli TX60, {'planned' if planned else 'simulated'}, {measures.upper()}",
        columns=head | _attitude(rotations, kind[1]) | {"sigma_deg": np.full(n, axis_deg)},
        robot=robot(nominal),
        sigma_mm=position_mm,
        source="made by datasets.makers.tx60 from Tables 2 and 3 of Mathematics 2023, 11, 4802",
        truth={"nominal": nominal, "geometry": true, "flange": flange},
    )


def geometries() -> tuple[np.ndarray, np.ndarray]:
    """Nominal and true (6, 5) theta, d, a, alpha, beta, rad and mm: Table 2, and that plus Table 3."""
    tables = papers.load("mathematics-2023")
    nominal = np.array(tables["table_2"]["nominal"], float)
    return nominal, nominal + np.array(tables["table_3"]["deviation"], float)


def robot(nominal: np.ndarray) -> dict:
    """The nominal robot.toml as a mapping."""
    rows = nominal * [180 / np.pi, 1, 1, 180 / np.pi, 180 / np.pi]
    joints = [
        {
            "theta_deg": theta,
            "d_mm": d,
            "a_mm": a,
            "alpha_deg": alpha,
            "hayati": k == 1,
            "limits_deg": list(limit),
        }
        for k, ((theta, d, a, alpha, _), limit) in enumerate(
            zip(rows.round(9).tolist(), np.array(_LIMITS).tolist())
        )
    ]
    return {
        "name": "Staubli TX60",
        "convention": "distal",
        "gravity": [0.0, 0.0, -1.0],
        "source": "nominal rows of Mathematics 2023, 11, 4802, Table 2",
        "joint": joints,
    }


def in_cube(rng: np.random.Generator, geometry: np.ndarray, n: int) -> np.ndarray:
    """(n, 6) joint angles, drawn over their ranges, whose flange is in the paper's cube, spread over the cube.

    The cube is parted into 125 cells, which are visited in turn as far as they are reached.
    """
    measurement = papers.load("mathematics-2023")["measurement"]
    limits = np.deg2rad(_LIMITS)
    drawn = rng.uniform(*limits.T, (150 * n, 6))
    drawn = drawn[(np.abs(drawn[:, 0]) > np.pi / 2) & (drawn[:, 1] < 0)]
    place = poses.forward_kinematics(geometry, drawn)[:, :3, 3] - measurement["cube_centre_mm"]
    drawn, place = (
        rows[np.abs(place).max(1) < measurement["cube_mm"] / 2] for rows in (drawn, place)
    )
    cell = np.floor((place / measurement["cube_mm"] + 0.5) * 5).astype(int) @ [25, 5, 1]
    order = np.argsort(cell, kind="stable")
    visit = np.empty(len(cell), int)
    visit[order] = np.arange(len(cell)) - np.searchsorted(cell[order], cell[order])
    return rng.permutation(drawn[np.argsort(visit, kind="stable")[:n]])


def _attitude(rotations: np.ndarray, axis: int | None) -> dict[str, np.ndarray]:
    """Columns of an axis of the flange (0 x, 1 y), or of its whole attitude."""
    if axis is None:
        return dict(zip(("qx", "qy", "qz", "qw"), Rotation.from_matrix(rotations).as_quat().T))
    names = (("nx", "ny", "nz"), ("ox", "oy", "oz"))[axis]
    return dict(zip(names, rotations[:, :, axis].T))


def main() -> None:
    """Write a folder."""
    import datasets

    parser = argparse.ArgumentParser(description="Make a partial-pose recording of a TX60.")
    parser.add_argument("out")
    parser.add_argument("--measures", choices=tuple(KINDS), default="op")
    parser.add_argument(
        "--planned", action="store_true", help="the nominal arm, nothing measured yet"
    )
    parser.add_argument("--samples", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    made = tx60(args.measures, args.samples, args.seed, args.planned)
    datasets.write(made.recording(), args.out)


if __name__ == "__main__":
    main()
