"""Files of a diagnosis in its run folder: residuals, smallest sizes, and the next experiment as a scene that runs."""

from pathlib import Path

import numpy as np

from workbench.core.text.csv_text import csv_text
from workbench.explanation.planning.scenes import ROBOT, SCENE
from workbench.explanation.result import Diagnosis
from workbench.files.results import rotation_columns

RESIDUALS = "residuals.csv"
DETECTABLE = "smallest-visible.csv"
POSES = "next-experiment-poses.csv"


def save(diagnosis: Diagnosis, folder: Path) -> None:
    """Write residuals.csv, smallest-visible.csv and, where there is one, next-experiment.toml with its poses."""
    folder = Path(folder)
    if diagnosis.views is not None:
        (folder / RESIDUALS).write_text(_residuals(diagnosis), encoding="utf-8")
    if diagnosis.detectable:
        rows = diagnosis.as_json()["smallest_visible"]
        keys = [key for key in rows[0] if key != "twin"]
        lines = [
            [*(row[key] for key in keys), *(row["twin"] or {"effect": "", "where": ""}).values()]
            for row in rows
        ]
        columns = [*keys, "twin", "twin_where"]
        (folder / DETECTABLE).write_text(csv_text(columns, lines), encoding="utf-8")
    _experiment(diagnosis, folder)


def _residuals(diagnosis: Diagnosis) -> str:
    """One line a sample: residual before and after (predicted minus measured), held-out errors, fold, outlier."""
    views = diagnosis.views
    proof = diagnosis.proof
    unit = diagnosis.unit
    names = [
        f"{stage}_{name}_{unit}"
        for stage in ("before", "after")
        for name in views.names[: len(views.before)]
    ]
    head = [
        "sample",
        *names,
        f"held_out_before_{unit}",
        f"held_out_after_{unit}",
        "fold",
        "outlier",
    ]
    out = set(diagnosis.outliers)
    columns = np.concatenate([views.before, views.after, proof.errors])
    for name, values in _rotation_columns(diagnosis).items():
        head.insert(-2, name)
        columns = np.concatenate([columns, values[None]])
    lines = []
    for i, row, fold in zip(views.sample, columns.T, proof.fold):
        lines.append([int(i), *(f"{v:.6g}" for v in row), int(fold), int(int(i) in out)])
    return csv_text(head, lines)


def _rotation_columns(diagnosis: Diagnosis) -> dict[str, np.ndarray]:
    """Name -> (n,) deg: residuals of the orientation and held-out angles; {} where none is measured."""
    views = diagnosis.views
    proof = diagnosis.proof
    if views.rotation is None:
        return {}
    columns = {}
    for stage, residual in zip(("before", "after"), views.rotation):
        columns |= {f"{stage}_{axis}_deg": row for axis, row in rotation_columns(residual).items()}
    if proof.angles is not None:
        columns |= dict(zip(("held_out_before_deg", "held_out_after_deg"), proof.angles))
    return columns


def _experiment(diagnosis: Diagnosis, folder: Path) -> None:
    import tomli_w

    plan = diagnosis.experiment
    if plan.scene is not None:
        (folder / SCENE).write_text(
            f"# {plan.sentence}\n" + tomli_w.dumps(plan.scene), encoding="utf-8"
        )
    if plan.robot is not None:
        (folder / ROBOT).write_text(tomli_w.dumps(dict(plan.robot)), encoding="utf-8")
    if plan.poses is not None:
        head = [f"joint {k}" for k in range(1, plan.poses.shape[1] + 1)]
        (folder / POSES).write_text(csv_text(head, plan.poses.round(6).tolist()), encoding="utf-8")
