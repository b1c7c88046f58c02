"""Residuals of a diagnosis in space: its files hold the residuals, its model gives the places."""

from dataclasses import replace

import numpy as np

from workbench.app.data.residuals import Residuals
from workbench.core.errors import InputError

AFTER = "after"
MOST_SAMPLES = 20_000
"""The whole recording is bound to the model: of a larger one it would take longer than a person waits for a click."""


def with_places(opened, found: Residuals) -> Residuals:
    """The residuals of a diagnosis with points and arrows in the robot's root frame, mm.

    They are returned as they are where the samples were made of images, where the recording is larger than
    `MOST_SAMPLES`, or where the solution cannot be read.
    """
    is_arm = opened.samples is opened.recording and AFTER in found.vectors
    if not is_arm or not 0 < opened.recording.n <= MOST_SAMPLES:
        return found
    try:
        return _placed(opened, found)
    except InputError:  # such as a solution of an older version
        return found


def _placed(opened, found: Residuals) -> Residuals:
    from robot_model.measurements import samples_of
    from robot_model.system import bind
    from workbench.core.model import Model
    from workbench.files.solution_file import read_solution
    from workbench.fitting.verdicts.residual_structure import in_root

    arm = read_solution(opened.folder)
    moving = samples_of(opened.recording)
    is_fitted = np.isin(moving.sample_ids, found.sample)
    model = Model(bind(arm.robot, moving, start_on=is_fitted), arm.effects)
    known = {key: value for key, value in arm.values.items() if key in model.parameters.index}
    order = np.argsort(moving.sample_ids, kind="stable")
    rows = order[np.searchsorted(moving.sample_ids[order], found.sample)]
    residual = np.zeros((3, len(moving.sample_ids)))
    residual[:, rows] = found.vectors[AFTER]
    points, arrows = in_root(model, model.parameters.update(known), residual)
    return replace(found, points=points[:, rows], arrows=arrows[:, rows])
