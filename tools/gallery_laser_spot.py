"""Writes docs/gallery/laser-spot.md and its image: every number on the page is computed here.

`python tools/gallery.py laser-spot` takes about three minutes. The functions are what the tests of the
paper call too.
"""

from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.makers import liu
from published_beam_spheres import A2, BeamFit, calibrate_beams
from robot_model import load_robot
from robot_model.chain import forward
from workbench.fitting.calibration_plans.plans import geometry as geometry_stage
from workbench.jobs.robot.calibrate import Calibration, calibrate

HERE = Path(__file__).parents[1] / "docs" / "gallery"
_NAMES = ("theta", "d", "a", "alpha")
# (joint, column) that beams along x cannot show: the base's turn and height, d2 (in d2 + d3), joint 6 with the beam
_UNSEEN = {(0, 0), (0, 1), (1, 1), (5, 0), (5, 1), (5, 2), (5, 3)}


def fit(made, with_crossings: bool, **options) -> BeamFit:
    """The published method: eq. 6, or eq. 7 where `with_crossings`."""
    joints, point = made.recording().joints, made.columns["point"]
    return calibrate_beams(load_robot(made.robot), joints, point, with_crossings, **options)


def ours(recording) -> Calibration:
    """What `workbench calibrate` makes of it with its geometry stage alone."""
    return calibrate(recording, plan=[geometry_stage(load_robot(recording.robot))])


def found(calibration: Calibration) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Geometry (6, 5), origin and direction (3,) of the beam on the flange."""
    _, geometry, own = calibration.model.chain.split(calibration.solution.parameters.values)
    return geometry, own[:3], Rotation.from_rotvec(own[3:6]).as_matrix()[:, 2]


def errors_found(made, geometry: np.ndarray) -> np.ndarray:
    """(6, 4) theta deg, d mm, a mm, alpha deg off the nominal arm, brought to the true size: a2 + d4 as in truth.

    d2 and d3 are put together in d3, since only their sum shows.
    """
    nominal, true = load_robot(made.robot).geometry, made.truth["geometry"]
    geometry = geometry.copy()
    geometry[1:, 1:3] *= (true[1, 2] + true[3, 1]) / (geometry[1, 2] + geometry[3, 1])
    geometry[2, 1] += geometry[1, 1]
    geometry[1, 1] = 0
    return (geometry - nominal)[:, :4] * [np.rad2deg(1), 1, 1, np.rad2deg(1)]


@cache
def unseen(seed: int = 77):
    """Exact beams of the true arm to 30 other places on the sphere, five each."""
    return liu.irb120(5, 30, 0.0, seed)


def beam_error(made, geometry: np.ndarray, origin=(0.0, 0, 0), direction=(1.0, 0, 0)) -> float:
    """mm RMS distance of the beams of `made`, as a calibrated arm believes them, from the best point of each place."""
    recording = made.recording()
    frames = forward(load_robot(made.robot), recording.joints.T, geometry)
    origins, ways = (
        frames.point(np.array(origin)).T,
        np.stack(frames.end, -1).transpose(1, 0, 2) @ np.array(direction),
    )
    off, point = 0.0, recording.columns["point"]
    for k in np.unique(point):
        o, w = origins[point == k], ways[point == k]
        flat = np.eye(3) - np.einsum("ni,nj->nij", w, w)
        best = np.linalg.solve(flat.sum(0), np.einsum("nij,nj->i", flat, o))
        off += (np.einsum("nij,nj->ni", flat, best - o) ** 2).sum()
    return float(np.sqrt(off / len(point)))


def half(made):
    """The recording with the first half of the beams of each place."""
    recording = made.recording()
    beams = recording.n // len(np.unique(recording.columns["point"]))
    return recording.select(np.arange(recording.n) % beams < beams // 2)


def compared(seeds=range(1, 6), beams: int = 12, sigma: float = 0.02) -> np.ndarray:
    """(seeds, 3) mm on other places: eq. 7 with a2 held, on all beams; ours on all, and on half of them."""
    new, rows = unseen(), []
    for seed in seeds:
        made = liu.irb120(beams, 7, sigma, seed)
        theirs = beam_error(new, fit(made, True, held=(A2,)).geometry)
        rows.append(
            (theirs, *(beam_error(new, *found(ours(r))) for r in (made.recording(), half(made))))
        )
    return np.array(rows)


def table_3(made, fits: list[np.ndarray]) -> str:
    """Markdown: every error of table 3 that beams can show, and what each geometry says of it."""
    columns = [errors_found(made, g) for g in fits]
    true = errors_found(made, made.truth["geometry"])
    lines = ["| | actual | eq. 6 | eq. 7 | ours |", "|---|---|---|---|---|"]
    for k in range(6):
        for c, name in enumerate(_NAMES):
            if (k, c) in _UNSEEN:
                continue
            label = "d2 + d3" if (k, c) == (2, 1) else f"{name}{k + 1}"
            unit = "mm" if name in "da" else "deg"
            cells = [f"{round(x[k, c], 4) + 0.0:.4f}" for x in columns]
            lines.append(f"| {label}, {unit} | {true[k, c]:.4g} | {' | '.join(cells)} |")
    return "\n".join(lines)


def shown(difference: np.ndarray) -> np.ndarray:
    """Those of (6, 4) that beams can show."""
    return np.array([difference[k, c] for k in range(6) for c in range(4) if (k, c) not in _UNSEEN])
