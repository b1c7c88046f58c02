"""Import of a table of flange poses and measured points: of a fixed ball in the frame of a sensor on the flange (kind
ball-centre), or of a point on the flange in the frame of a stationary instrument (kind external-point).

Arrangement, rotation convention and units are tested by how well one transform keeps the ball, or the point on the
flange, in its place.
"""

from dataclasses import replace

import numpy as np

from datasets.importers.mapping.candidates import length_units
from datasets.importers.mapping.conversion import complete_rows, other_columns, point_columns
from datasets.importers.mapping.model import Group, Mapping
from datasets.recording import Recording
from workbench.core.rigid import inverse
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
from workbench.recordings.importing.target_poses.centre_layouts import FEWEST, share_left
from workbench.recordings.importing.target_poses.motion_gaps import named_gaps

_KINDS = ("ball-centre", "external-point", None)
_PLACES = {"ball-centre": "sensor on the flange", "external-point": "point on the flange"}
"""Arrangement of each kind: which of the two is on the flange. The other one stands still."""
_MOST_LEFT = 0.01
"""Share of the scatter of points that an instrument measured, which are as wide as the motion of the arm, up to which
flange poses fit them."""
_HOPELESS = 0.5
"""Share of the scatter of the flange that no convention and no matrix explain: a quarter of the rows may be wrong."""
_FEWEST = 6
_UNITS = ("mm", "m")
_WIDEST_M = 10.0
"""Flange positions beyond it are not in metres."""


def import_centres(found, options, progress) -> Made | None:
    """Recording, mapping and fits of a table of flange poses and measured points; None for any other table.

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
    mapping = replace(mapping, rotation=None, axis=None)
    stated = options.mapping.measures
    kinds = tuple(_PLACES) if stated is None else (stated,)
    rows, notes = complete_rows(found.table, mapping)
    others = other_columns(rows, mapping)
    if rows.n < _FEWEST or len(np.unique(others.get("ball", [1]))) > 1:
        return None
    place, rotation, point = mapping.flange_point, mapping.flange_rotation, mapping.point
    if rows.n >= FEWEST and share_left(rows, place, rotation, point.columns) > _HOPELESS:
        return None
    progress("testing readings of the flange poses")
    readings, fits = _compared(rows, mapping, kinds)
    if not fits or not fits[0][1].is_good:
        return None
    lines = [
        f'measures = "{read.measures}", {reading_line(read)}'
        if len(kinds) > 1
        else reading_line(read)
        for _, read, _ in readings
    ]
    with named_gaps(rows.file, fits, lambda place: readings[place][2]):
        chosen = choose_reading(lines, fits, f"{rows.file}, flange poses", options.ask)
    _, mapping, poses = readings[chosen]
    suspicions = tuple(
        f"{rows.file}: {_in_words_of(mapping.measures, suspicion)}."
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


def import_positions_alone(found, options, progress, reason: str) -> Made | None:
    """Flange poses and the positions of a target whose rotations do not fit; None where the positions do not, either.

    reason: what in the poses of the target disagrees. Raises as `import_centres`.
    """
    if options.mapping.measures is not None:
        return None
    rotations = ", ".join(found.mapping.rotation.columns)
    mapping = replace(found.mapping, measures=None, rotation=None)
    made = import_centres(replace(found, mapping=mapping), options, progress)
    if made is None:
        return None
    sentence = (
        f"{found.table.file}: the poses of the target do not fit the flange poses ({reason}), and their positions "
        f"alone fit with {made.fits[0].rms_mm:.3g} mm. The positions are read as measured points and the rotations "
        f"({rotations}) are left out: find out which frame they belong to before you use them."
    )
    return made.with_suspicions((sentence,))


def _compared(rows, mapping: Mapping, kinds):
    """Readings of flange poses and points, and index and fit of each that was compared, the most probable first.

    kinds: those that are possible. Poses of the readings of a point on the flange are inverted.
    """
    flange = np.concatenate([rows.columns[name] for name in mapping.flange_point.columns])
    usual = "mm" if np.abs(flange).max() > _WIDEST_M else "m"
    stated = length_units(mapping.flange_point)
    if len(stated) > 1:
        mapping = mapping.updated("flange_point", unit=usual)
    units = length_units(mapping.point)
    readings, fits = [], []
    for unit in units if len(units) == 1 else _UNITS:
        of_unit = flange_readings(rows, mapping.updated("point", unit=unit))
        scans = _scans(rows, of_unit[0][1].point)
        for kind in kinds:
            made = [_arranged(reading, kind) for reading in of_unit]
            found = compare_poses(made, scans)
            fits += [
                (len(readings) + place, _named(fit, f"{unit}; {_PLACES[kind]}", kind, scans))
                for place, fit in found
            ]
            readings += made
    return readings, sorted(fits, key=lambda item: item[1].improbability)


def _arranged(reading, kind: str):
    """A reading (title, mapping, poses) of the flange poses with the kind, and the poses of what carries the sensor."""
    title, mapping, poses = reading
    poses = inverse(poses) if kind == "external-point" else poses
    return title, replace(mapping, measures=kind), poses


def _named(fit: CandidateFit, words: str, kind: str, scans: Scans) -> CandidateFit:
    fit = replace(fit, title=f"{fit.title}, points in {words}")
    if kind != "external-point":
        return fit
    scatter = float(np.linalg.norm(scans.seen.std(axis=1)))
    is_good = fit.is_good or fit.rms_mm <= _MOST_LEFT * scatter
    return replace(fit, is_good=is_good)


def _in_words_of(kind: str, suspicion: str) -> str:
    """A sentence on a fixed ball, in the words of a point on the flange where that was measured."""
    return suspicion.replace("the ball", "the point") if kind == "external-point" else suspicion


def _scans(rows, point: Group) -> Scans:
    """The centres as scans of a ball whose radius does not matter."""
    seen = np.stack(list(point_columns(rows, point).values()))
    names = [f"row {line}" for line in rows.lines]
    return Scans(seen, np.empty(0), names, 0.0, False)


def _recording(rows, mapping: Mapping, others, options) -> Recording:
    columns = {"sample": np.arange(1.0, rows.n + 1)}
    if mapping.measures == "ball-centre":
        columns["ball"] = np.ones(rows.n)
    columns |= pose_columns(rows, mapping, {})
    columns |= point_columns(rows, mapping.point)
    columns |= {name: cells for name, cells in others.items() if cells.dtype.kind == "f"}
    return Recording(
        measures=mapping.measures,
        columns=columns,
        robot={},
        sigma_mm=options.sigma_mm,
        name=options.name,
    )
