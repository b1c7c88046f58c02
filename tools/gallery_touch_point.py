"""Writes docs/gallery/touch-point.md and its image: every number on the page is computed here.

`python tools/gallery.py touch-point` takes about three minutes. The functions are what the tests of
the paper call too.
"""

from pathlib import Path

import numpy as np

from datasets import papers
from datasets.makers import gubankov
from published_touch_pairs import PairFit, calibrate_pairs, pairs_of, start_tip
from robot_model import load_robot
from robot_model.chain import forward
from workbench.fitting.calibration_plans.plans import geometry as geometry_stage
from workbench.jobs.robot.calibrate import Calibration, calibrate

HERE = Path(__file__).parents[1] / "docs" / "gallery"
PAPER = papers.load("gubankov-2022")
LENGTHS = ([1, 2, 3], [2, 2, 1])  # a2, a3, d4 in a geometry (6, 5)


def ours(made) -> Calibration:
    """What `workbench calibrate` makes of the recording with its geometry stage alone."""
    return calibrate(made.recording(), plan=[geometry_stage(load_robot(made.robot))])


def found(calibration: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """Geometry (6, 5) and tip (3,) of a calibration."""
    _, geometry, own = calibration.model.chain.split(calibration.solution.parameters.values)
    return geometry, own[:3]


def pairs(made, **options) -> PairFit:
    """The published method on the same recording."""
    recording = made.recording()
    return calibrate_pairs(
        load_robot(made.robot), recording.joints, recording.columns["point"], **options
    )


def tip_errors(
    made, joints: np.ndarray, geometry: np.ndarray, tip: np.ndarray
) -> dict[str, np.ndarray]:
    """(n,) mm of each joint vector: `direct`; `base`, after removing the turn about and the shift along joint 1's
    axis, which no touch can tell (theta1, d1); `size`, after removing one scale factor, too."""
    true = gubankov.tips(made.truth["geometry"], made.truth["tip"], joints)
    seen = gubankov.tips(geometry, tip, joints)
    based = _base_removed(seen, true)
    # of all scale factors the best, with the base's shift free: linear in both
    system = np.column_stack([based.ravel(), np.tile([0.0, 0, 1], len(based))])
    factors = np.linalg.lstsq(system, true.ravel(), rcond=None)[0]
    sized = based * factors[0] + [0, 0, factors[1]]
    return {
        name: np.linalg.norm(x - true, axis=1)
        for name, x in (("direct", seen), ("base", based), ("size", sized))
    }


def _base_removed(seen, true):
    (x, y), (u, v) = seen.T[:2], true.T[:2]
    turn = np.arctan2((x * v - y * u).sum(), (x * u + y * v).sum())
    c, s = np.cos(turn), np.sin(turn)
    return np.column_stack([c * x - s * y, s * x + c * y, seen[:, 2] + (true - seen)[:, 2].mean()])


def size_error(made, geometry: np.ndarray) -> float:
    """By what part the main lengths a2, a3, d4 together are too large."""
    true = made.truth["geometry"][LENGTHS]
    return float(geometry[LENGTHS] @ true / (true @ true)) - 1


def start_of(made) -> np.ndarray:
    """(3,) the published start of the tip, mm."""
    recording = made.recording()
    return start_tip(
        forward(load_robot(made.robot), recording.joints.T), recording.columns["point"]
    )


def pair_gaps(made, geometry: np.ndarray, tip: np.ndarray) -> np.ndarray:
    """(L,) mm between the tips of every two touches of one point."""
    recording = made.recording()
    places = gubankov.tips(geometry, tip, recording.joints)
    first, second = pairs_of(recording.columns["point"])
    return np.linalg.norm(places[first] - places[second], axis=1)


def nominal(made) -> np.ndarray:
    """(6, 5) nominal geometry of a recording's robot."""
    return load_robot(made.robot).geometry


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def icp_rms(cloud: str) -> float:
    """mm RMS of a cloud of table 1 against the tracker's after Open3D's ICP from centred clouds."""
    import open3d

    reg = open3d.pipelines.registration
    clouds = []
    for name in (cloud, "tracker"):
        points = papers.cloud(PAPER["table_1"], name)
        clouds.append(
            open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points - points.mean(0)))
        )
    rule = reg.ICPConvergenceCriteria(1e-12, 1e-12, 200)
    return float(
        reg.registration_icp(
            *clouds, 100.0, np.eye(4), reg.TransformationEstimationPointToPoint(), rule
        ).inlier_rmse
    )


def paired(seeds: int) -> np.ndarray:
    """(seeds, 4): size error of the pair objective as it stops, and iterated on; of ours; and ours on points not
    touched, mm RMS with theta1 and d1 removed. Driving errors up to 0.16 mm."""
    rows = []
    for seed in range(seeds):
        made = gubankov.rv2fb(0.16, seed)
        geometry, tip = found(ours(made))
        further = pairs(made, least_fall=1e-3).geometry
        error = rms(tip_errors(made, gubankov.unseen(made, 100), geometry, tip)["base"])
        sizes = [size_error(made, g) for g in (pairs(made).geometry, further, geometry)]
        rows.append((*sizes, error))
    return np.array(rows)


def sweep(tilts=(25, 45, 60, 80), seeds=range(1, 9)) -> list[tuple[float, float, float, float]]:
    """Rows of tilt (deg), J that the published method starts from, ours and the pair objective elsewhere, mm RMS."""
    rows = []
    for tilt in tilts:
        cases = [gubankov.rv2fb(0.16, seed, tilt) for seed in seeds]
        fits = [pairs(made) for made in cases]
        joints = [gubankov.unseen(made, 100) for made in cases]
        mine = [tip_errors(m, q, *found(ours(m)))["base"] for m, q in zip(cases, joints)]
        theirs = [
            tip_errors(m, q, f.geometry, f.tip)["base"] for m, q, f in zip(cases, joints, fits)
        ]
        rows.append((tilt, np.mean([f.objective[0] for f in fits]), rms(mine), rms(theirs)))
    return rows


def rv2fb_table() -> str:
    """Markdown of the RV-2FB case, one recording without and one with positioning errors."""
    lines = ["| | published | their method here | ours |", "|---|---|---|---|"]
    for error, key in ((0.0, ""), (0.16, "_with_driving_error")):
        made, table = gubankov.rv2fb(error), PAPER["rv2fb"]
        fit, (geometry, tip), joints = pairs(made), found(ours(made)), gubankov.unseen(made)
        touched = made.recording().joints
        ours_gap = (pair_gaps(made, geometry, tip) ** 2).sum()
        before, after = table[f"objective{key}_before_mm2"], table[f"objective{key}_after_mm2"]
        name = f"positioning errors up to {error:g} mm" if error else "no positioning errors"
        theirs = f"{fit.objective[0]:.0f} → {fit.objective[-1]:.2g}"
        lines += [
            f"| **{name}** | | | |",
            f"| J, mm² | {before} → {after} | {theirs} | {ours_gap:.2g} |",
        ]
        places = (
            ("tip at touched points, max mm", touched),
            ("tip at 500 other positions, RMS (max), mm", joints),
        )
        for label, q in places:
            theirs, mine = (
                tip_errors(made, q, fit.geometry, fit.tip),
                tip_errors(made, q, geometry, tip),
            )
            for kind, words in (
                ("direct", ""),
                ("base", ", d1 and theta1 removed"),
                ("size", ", scale removed as well"),
            ):
                both = [
                    f"{x[kind].max():.2g}"
                    if "max mm" in label
                    else f"{rms(x[kind]):.2g} ({x[kind].max():.2g})"
                    for x in (theirs, mine)
                ]
                said = (
                    f"{table[f'tcp_error{key}_mm']:g}"
                    if kind == "direct" and "touched, max" in label
                    else ""
                )
                lines.append(f"| {label}{words} | {said} | {both[0]} | {both[1]} |")
        sizes = size_error(made, fit.geometry), size_error(made, geometry)
        lines.append(f"| relative error of a2, a3, d4 | | {sizes[0]:+.1e} | {sizes[1]:+.1e} |")
    return "\n".join(lines)


def ur10e_table() -> str:
    """Markdown of the UR10e case for several positioning errors."""
    lines = [
        "| positioning errors up to | J before → after, mm² | falls by | rms pair distance falls by |",
        "|---|---|---|---|",
        '| published (real) | 1120 → 28.7 | 39 × | "more than ten" |',
    ]
    for error in (0.0, 0.05, 0.1, 0.16, 0.26):
        made = gubankov.ur10e(error)
        before, after = (
            pair_gaps(made, nominal(made), start_of(made)),
            pair_gaps(made, *found(ours(made))),
        )
        fall = (before**2).sum() / (after**2).sum()
        lines.append(
            f"| {error:g} mm | {(before**2).sum():.0f} → {(after**2).sum():.2g} | {fall:.3g} × | "
            f"{rms(before) / rms(after):.3g} × |"
        )
    return "\n".join(lines)


def registration_table() -> str:
    """Markdown of table 1's three clouds."""
    lines = ["| cloud | published | closed form | Open3D ICP |", "|---|---|---|---|"]
    table = PAPER["table_1"]
    for name in ("identified", "controller", "nominal"):
        closed = papers.registration_rms(papers.cloud(table, name), papers.cloud(table, "tracker"))
        lines.append(
            f"| {name} | {PAPER['registration'][name + '_mm']} | {closed:.4f} | {icp_rms(name):.4f} |"
        )
    return "\n".join(lines)
