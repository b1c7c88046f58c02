"""One run of a study, determined by its number only: the same row on any machine, in any order."""

from fnmatch import fnmatchcase

import numpy as np

from workbench.core.errors import InputError
from workbench.studies import resampling, robots
from workbench.studies.robots import Row
from workbench.studies.spec import Study
from workbench.studies.variation import values_of, with_values


def row_of(study: Study, run: int) -> Row:
    """The row of run 1, 2, …: its number, the varied values, its figures, and the outcome.

    The outcome is "done". A run with unusable input (too few poses, an unreachable ball) has the message as `outcome`
    and no figures.
    """
    values = values_of(study, run)
    row: Row = {"run": run, **{name: _cell(value) for name, value in values.items()}}
    try:
        run_study = with_values(study, values)
        figures = _figures(run_study, seed_of(study, run))
    except InputError as problem:
        return row | {"outcome": str(problem)}
    cells = {
        k: _cell(v)
        for k, v in figures.items()
        if any(fnmatchcase(k, pattern) for pattern in study.keep)
    }
    return row | cells | {"outcome": "done"}


def seed_of(study: Study, run: int) -> int:
    """Seed of a run: child `run` of the study's seed (numpy's SeedSequence).

    With `same_noise` all points share the seeds of their repeats.
    """
    vary = study.vary
    child = (run - 1) % vary.repeats + 1 if vary.same_noise else run
    return int(
        np.random.SeedSequence(study.seed, spawn_key=(child,)).generate_state(1, np.uint64)[0] >> 1
    )


def _figures(study: Study, seed: int) -> Row:
    if study.kind == "sensor":
        from workbench.studies.sensors import figures

        return figures(study, seed)
    if study.recording is not None:
        return _of_recording(study, seed)
    world = robots.world(study, seed)
    if "simulate" in study.do:
        row = robots.simulated(world, study.kind == "compliance")
    else:
        row = {}
    figures_of_run = {}
    if "calibrate" in study.do:
        figures_of_run = robots.calibrations(study, world.measured)
        row |= robots.errors_row(figures_of_run, world.tests) | (
            robots.parameter_row(figures_of_run) if study.parameters else {}
        )
    if "compensate" in study.do:
        row |= robots.compensated(figures_of_run, world)
    return row | (robots.diagnosed(study, world.measured) if "diagnose" in study.do else {})


def _of_recording(study: Study, seed: int) -> Row:
    recording = resampling.resampled(study, np.random.default_rng(seed))
    row: Row = {"samples": recording.n}
    if "calibrate" in study.do:
        calibrations = robots.calibrations(study, recording)
        row |= robots.errors_row(calibrations, {})
        row |= robots.parameter_row(calibrations, same_arm=True) if study.parameters else {}
    return row | (robots.diagnosed(study, recording) if "diagnose" in study.do else {})


def _cell(value):
    """A value as a table cell; a list becomes text."""
    if isinstance(value, list):
        return " ".join(f"{v:g}" if isinstance(v, int | float) else str(v) for v in value)
    if isinstance(value, np.generic):
        return value.item()
    return value
