"""The sound recordings that `user_errors` makes mistakes in: the bundled one, simulated ones, real ones."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import datasets
from datasets.recording import Recording
from datasets.samples.columns import POINT, QUATERNION
from robot_model.measurements import samples_of
from workbench.files.scene import Scene
from workbench.jobs.robot.simulate import truth_from

_NOISE_MM = 0.02
_COMPLIANT = [
    {"effect": "joint-compliance", "where": f"joint-{k}", "values": {"compliance": 4e-6}}
    for k in (2, 3)
]
_BALLS = [[0, 0, 0, 15], [120, 5, -3, 15], [10, 150, 4, 15], [60, 70, 60, 15]]


def _scene(robot, measures, seed, **more) -> Recording:
    scene = Scene.model_validate(
        {
            "robot": robot,
            "measures": measures,
            "seed": seed,
            "samples": 120,
            "sigma_mm": _NOISE_MM,
            "base": {"xyz_mm": [1400, -300, 250], "rpy_deg": [3, -5, 40]},
            "tool": {"xyz_mm": [35, -20, 110], "rpy_deg": [12, 25, -50]},
            "errors": {"length_mm": 0.5, "angle_deg": 0.08},
            "payload_kg": [0.2, 2.5],
            "temperature_c": [20, 27],
            "effect": _COMPLIANT,
            **more,
        }
    )
    truth = truth_from(scene, Path("scene.toml"))
    residual, sigma = truth.model.residual(truth.parameters), truth.model.sigma(truth.parameters)
    noisy = residual + truth.rng.normal(size=residual.shape) * sigma
    made = replace(
        truth.shown, columns=truth.shown.columns | truth.model.chain.measurement.columns(noisy)
    )
    return replace(made, name=f"{robot} {measures}")


def _point():
    reflectors = [[40, 10, 90], [-60, 30, 70], [5, -80, 120]]
    return _scene("kuka_kr6_r900", "external-point", 11, reflectors=reflectors)


def _pose():
    return _scene("ur10e", "external-pose", 12)


def _partial():
    made = _scene("staubli_tx90l", "external-pose", 13)
    turns = Rotation.from_quat(np.stack([made.columns[f"q{c}"] for c in "xyzw"], -1)).as_matrix()
    columns = {k: v for k, v in made.columns.items() if k not in QUATERNION}
    axis = dict(zip(("nx", "ny", "nz"), turns[:, :, 0].T))
    return replace(
        made, measures="partial-pose", columns=columns | axis, name="staubli_tx90l partial-pose"
    )


def _balls():
    base = {"xyz_mm": [-420, 80, -60], "rpy_deg": [2, -3, 25]}
    tool = {"xyz_mm": [20, -15, 90], "rpy_deg": [5, -8, 30]}
    return _scene("abb_irb120", "ball-centre", 14, balls=_BALLS, base=base, tool=tool, cap_deg=50.0)


def _elastic():
    return samples_of(datasets.read("elastic-arm"))


def ur10_recording(folder: Path, n: int = 300) -> Recording:
    """The first `n` usable poses of the T-Mac recording of a UR10, as `external-pose`."""
    rows = (folder / "measurements_grid.csv").read_text(encoding="utf-8").splitlines()[1:]
    table = np.array(
        [
            [float(c.replace(",", ".")) if c else np.nan for c in row.split(";")]
            for row in rows[: 2 * n]
        ]
    )
    table = table[np.isfinite(table).all(1)]
    points, turns = table[:, 14:17], Rotation.from_euler("XYZ", table[:, 17:20], degrees=True)
    near = np.linalg.norm(points - np.median(points, axis=0), axis=1) < 4000
    quaternions = turns.as_quat()
    columns = {"sample": np.arange(1.0, len(table) + 1)}
    columns |= {f"q{k + 1}_deg": np.rad2deg(table[:, 7 + k]) for k in range(6)}
    columns |= dict(zip(POINT, points.T)) | dict(zip(("qx", "qy", "qz", "qw"), quaternions.T))
    columns |= {"temperature_c": table[:, 13]}
    made = Recording(
        "external-pose", columns, {"builtin": "ur10"}, sigma_mm=0.05, name="ur10_ipa_tmac_A"
    )
    return made.select(np.flatnonzero(near)[:n])


SIMULATED = {
    "elastic-arm": _elastic,
    "external-point": _point,
    "external-pose": _pose,
    "partial-pose": _partial,
    "ball-centre": _balls,
}
REAL = {
    "irb120_faro": lambda folder: samples_of(datasets.read("irb120_faro")).select(np.arange(600)),
    "motoman_leica_ctu": lambda folder: samples_of(datasets.read("motoman_leica_ctu:left")),
    "ur10_ipa_tmac_A": ur10_recording,
}


@cache
def simulated(name: str) -> Recording:
    """One of the recordings that need no file of others."""
    return SIMULATED[name]()
