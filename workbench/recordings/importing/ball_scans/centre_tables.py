"""Import of a table of flange poses and ball centres in the frame of a sensor on the flange (kind ball-centre).

Rotation convention and units are tested by how well one transform from flange to sensor keeps the ball in its place.
"""

from dataclasses import replace

import numpy as np

from datasets.importers.mapping.candidates import length_units
from datasets.importers.mapping.conversion import complete_rows, other_columns, point_columns
from datasets.importers.mapping.model import Group, Mapping
from datasets.recording import Recording
from workbench.recordings.importing.ball_scans.scan_review import Scans, pose_suspicions
from workbench.recordings.importing.ball_scans.surface_scans import compare_poses
from workbench.recordings.importing.board_images.pose_readings import (
    flange_readings,
    pose_columns,
    reading_line,
)
from workbench.recordings.importing.interpretation.decisions import choose_reading
from workbench.recordings.importing.interpretation.fits import CandidateFit
from workbench.recordings.importing.measured_robot import Made

_KINDS = ("ball-centre", "external-point", None)
_FEWEST = 6
_UNITS = ("mm", "m")
_WIDEST_M = 10.0
"""Flange positions beyond it are not in metres."""


def import_centres(found, options, progress) -> Made | None:
    """Recording, mapping and fits of a table of flange poses and centres of one ball; None for any other table.

    found, options: as of `import_table`. Raises InputError where several readings fit and nobody can be asked.
    """
    mapping = found.mapping
    is_centres = (
        mapping.joints is None
        and mapping.flange_rotation is not None
        and None not in (mapping.point, mapping.flange_point)
        and mapping.measures in _KINDS
    )
    if not is_centres or found.timed is not None or found.table is None:
        return None
    mapping = replace(mapping, measures="ball-centre", rotation=None, axis=None)
    rows, notes = complete_rows(found.table, mapping)
    others = other_columns(rows, mapping)
    if rows.n < _FEWEST or len(np.unique(others.get("ball", [1]))) > 1:
        return None
    progress("testing readings of the flange poses")
    readings, fits = _compared(rows, mapping)
    if not fits or not fits[0][1].is_good:
        return None
    lines = [reading_line(interpretation) for _, interpretation, _ in readings]
    chosen = choose_reading(lines, fits, f"{rows.file}, flange poses", options.ask)
    _, mapping, poses = readings[chosen]
    suspicions = tuple(
        f"{rows.file}: {suspicion}."
        for suspicion in pose_suspicions(_scans(rows, mapping.point).with_poses(poses))
    )
    recording = _recording(rows, mapping, others, options)
    return Made(
        recording,
        mapping,
        tuple(fit for _, fit in fits),
        (*notes, *suspicions),
        suspicions=suspicions,
    )


def _compared(rows, mapping: Mapping):
    """Readings of flange poses and centres, and index and fit of each that was compared, the most probable first."""
    flange = np.concatenate([rows.columns[name] for name in mapping.flange_point.columns])
    usual = "mm" if np.abs(flange).max() > _WIDEST_M else "m"
    stated = length_units(mapping.flange_point)
    if len(stated) > 1:
        mapping = mapping.updated("flange_point", unit=usual)
    units = length_units(mapping.point)
    readings, fits = [], []
    for unit in units if len(units) == 1 else _UNITS:
        made = flange_readings(rows, mapping.updated("point", unit=unit))
        found = compare_poses(made, _scans(rows, made[0][1].point))
        fits += [(len(readings) + place, _named(fit, unit)) for place, fit in found]
        readings += made
    return readings, sorted(fits, key=lambda item: item[1].improbability)


def _named(fit: CandidateFit, unit) -> CandidateFit:
    return replace(fit, title=f"{fit.title}, centres in {unit}")


def _scans(rows, point: Group) -> Scans:
    """The centres as scans of a ball whose radius does not matter."""
    seen = np.stack(list(point_columns(rows, point).values()))
    names = [f"row {line}" for line in rows.lines]
    return Scans(seen, np.empty(0), names, 0.0, False)


def _recording(rows, mapping: Mapping, others, options) -> Recording:
    columns = {"sample": np.arange(1.0, rows.n + 1), "ball": np.ones(rows.n)}
    columns |= pose_columns(rows, mapping, {})
    columns |= point_columns(rows, mapping.point)
    columns |= {name: cells for name, cells in others.items() if cells.dtype.kind == "f"}
    return Recording(
        measures="ball-centre",
        columns=columns,
        robot={},
        sigma_mm=options.sigma_mm,
        name=options.name,
    )
