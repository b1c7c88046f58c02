"""Residuals by the number of the sample, also of samples that did not enter a calibration: its model predicts them."""

from collections.abc import Iterable

import numpy as np

from workbench.app.data.opened import Opened
from workbench.app.data.places import MOST_SAMPLES
from workbench.app.edits.session import CALIBRATE
from workbench.core.errors import InputError


def lengths_by_number(opened: Opened, numbers: Iterable[int]) -> dict[int, float]:
    """Sample number -> mm, largest residual of the rows of a run that stem from some samples; {} without a run."""
    if opened.residuals is None:
        return {}
    rows = np.flatnonzero(np.isin(opened.edit_ids, list(numbers)))
    rows = rows[np.argsort(opened.residuals.shown[rows])]  # of one sample the largest is kept
    return dict(zip(opened.edit_ids[rows].tolist(), opened.residuals.shown[rows].tolist()))


def predicted_lengths(opened: Opened) -> dict[int, float]:
    """Sample number -> mm, 3-D length of the residual of each sample of the recording under the model of the run.

    A sample that the run left out has no part in the fit, so that its length is a prediction. {} where there is no
    calibration, where the samples were made of images, or where the recording is larger than `MOST_SAMPLES`.
    """
    if opened.command != CALIBRATE or opened.samples is not opened.recording:
        return {}
    if not 0 < opened.recording.n <= MOST_SAMPLES or opened.residuals is None:
        return {}
    try:
        return _lengths(opened)
    except InputError:  # such as a solution of an older version
        return {}


def _lengths(opened: Opened) -> dict[int, float]:
    from robot_model.measurements import samples_of
    from robot_model.system import bind
    from workbench.core.model import Model
    from workbench.files.solution_file import read_solution
    from workbench.fitting.cross_validation import in_space

    arm = read_solution(opened.folder)
    moving = samples_of(opened.recording)
    fitted = np.isin(moving.sample_ids, opened.residuals.sample)
    model = Model(bind(arm.robot, moving, start_on=fitted), arm.effects)
    known = {key: value for key, value in arm.values.items() if key in model.parameters.index}
    residual = in_space(model.residual(model.parameters.update(known)))
    lengths = np.sqrt((residual**2).sum(0))
    return dict(zip(moving.sample_ids.tolist(), lengths.tolist()))
