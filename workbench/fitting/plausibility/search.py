"""Search for the correction, or the few corrections, that bring a recording near its robot.

Screening: base and tool are fitted at the nominal geometry under every single correction and under every
combination of signs and of columns in radians or gon. Beam search joins the best single corrections, and those of all
columns of a kind, with every other one.
The most promising candidates are fitted again with plausible geometry errors, and that fit decides.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from datasets.samples.columns import QUATERNION, joint_columns
from workbench.fitting.plausibility.fitting import (
    FAILURES,
    Fit,
    fit_recording,
    flange_scatter,
    nominal_scales,
    unexplainable_misfit_mm,
)
from workbench.fitting.plausibility.hypotheses.artefact_corrections import artefact_corrections
from workbench.fitting.plausibility.hypotheses.corrections import (
    Correction,
    has_orientation,
    join,
    point_columns,
)
from workbench.fitting.plausibility.hypotheses.coupling_corrections import coupling_corrections
from workbench.fitting.plausibility.hypotheses.joint_corrections import (
    joint_corrections,
    order_vectors,
    sign_vectors,
    unit_vectors,
)
from workbench.fitting.plausibility.hypotheses.point_corrections import point_corrections
from workbench.fitting.plausibility.hypotheses.robot_corrections import robot_corrections
from workbench.fitting.plausibility.hypotheses.row_corrections import ROWS, row_corrections
from workbench.fitting.plausibility.sampling import even_rows

_SCREEN_ROWS, _JUDGE_ROWS = 50, 200
_MAX_FITTED, _PROMISING = 8, 4.0
_BEAM = 5
_DEEPEST = 3
SIGN, UNITS = "joint-sign", ("joint-unit", "length-unit")
_PROGRESS = 0.8
_WITHOUT_LENGTHS = ("touch-point", "plane-touch")
CLOSE = 1.5
"""Candidates within this factor of the smallest scale explain the data about equally well."""


@dataclass(frozen=True)
class Candidate:
    """A correction and the scale (mm) that it leaves in the screening fit, in terms of the data as recorded."""

    correction: Correction
    scale: float


@dataclass(frozen=True)
class Explanation:
    """A correction and the fit with plausible geometry errors under it."""

    correction: Correction
    fit: Fit


def single_corrections(robot, recording) -> list[Correction]:
    """Every single mistake that is searched for."""
    return [
        *joint_corrections(robot, recording),
        *point_corrections(recording),
        *row_corrections(recording),
        *artefact_corrections(recording),
        *robot_corrections(robot),
        *coupling_corrections(robot),
    ]


@dataclass(frozen=True)
class Search:
    """State of the search: explanations, the best first, and the screened candidates to continue from."""

    explanations: tuple[Explanation, ...]
    beam: tuple[Candidate, ...]
    singles: tuple[Correction, ...]


def search_singles(robot, recording) -> Search:
    """Every single correction, every combination of signs and of columns in one unit, and cycles of three joints."""
    singles = _in_terms_of_motion(robot, recording, single_corrections(robot, recording))
    vectors = [
        *sign_vectors(recording),
        *unit_vectors(recording),
        *order_vectors(recording),
    ]
    vectors = _in_terms_of_motion(robot, recording, vectors)
    screened = screen(robot, recording, [*singles, *vectors])
    return Search(tuple(judge(robot, recording, screened)), tuple(screened), tuple(singles))


def _in_terms_of_motion(robot, recording, corrections: list[Correction]) -> list[Correction]:
    """Corrections of a recording without coordinates or lengths, whose misfit counts in relation to the motion.

    A tip stays near a fixed point, whatever it touches, once the readings hardly move the arm.
    """
    if recording.measures not in _WITHOUT_LENGTHS:
        return corrections
    scatter = max(flange_scatter(robot, recording), 1e-9)
    found = []
    for correction in corrections:
        try:
            share = flange_scatter(*correction.apply(robot, recording)) / scatter
        except FAILURES:
            continue
        found.append(replace(correction, magnification=max(share, 1e-9)))
    return found


def search_further(robot, recording, search: Search, sufficient_scale: float) -> Search:
    """Beam search: the best candidates with every single correction of other columns, until one fits.

    sufficient_scale: scale in mm at which a fit is good and no further mistake is searched for.
    """
    before = search.beam[0].scale if search.beam else np.inf
    seeds = [*_seeds(search.beam), *_of_all_columns(recording, search.singles)]
    for _ in range(_DEEPEST - 1):
        joined = _joined(seeds, search.singles)
        beam = screen(robot, recording, joined)
        found = _best([*search.explanations, *judge(robot, recording, beam)])
        search = Search(tuple(found), tuple(beam), search.singles)
        if (
            (found and found[0].fit.scale <= sufficient_scale)
            or not beam
            or beam[0].scale > _PROGRESS * before
        ):
            break
        before = beam[0].scale
        seeds = _seeds(search.beam)
    return search


def screen(robot, recording, corrections: Iterable[Correction]) -> list[Candidate]:
    """Candidates by the scale that they leave at the nominal geometry, the smallest first."""
    rows = even_rows(recording, _SCREEN_ROWS)
    corrections = list(corrections)
    scales = _screened_scales(robot, recording, corrections, rows)
    candidates = [Candidate(*pair) for pair in zip(corrections, scales)]
    finite = [candidate for candidate in candidates if np.isfinite(candidate.scale)]
    return sorted(finite, key=lambda c: (c.scale, c.correction.mistake_count))


def _screened_scales(robot, recording, corrections: list[Correction], rows) -> list[float]:
    """The scale under each correction; inf where it cannot be had."""
    cases = {}
    for k, correction in enumerate(corrections):
        try:
            arm, corrected = correction.apply(robot, recording)
            cases[k] = arm, corrected.select(rows[rows < corrected.n])
        except FAILURES:
            continue
    scales = [np.inf] * len(corrections)
    for k, scale in zip(cases, nominal_scales(list(cases.values()))):
        scales[k] = corrections[k].comparable(scale)
    return scales


def judge(robot, recording, candidates: list[Candidate]) -> list[Explanation]:
    """The candidates fitted with plausible geometry errors, the best first; none that these cannot make fit."""
    rows = even_rows(recording, _JUDGE_ROWS)
    found = []
    for candidate in _promising(candidates):
        arm, corrected = candidate.correction.apply(robot, recording)
        if candidate.scale > candidate.correction.comparable(
            unexplainable_misfit_mm(arm, corrected)
        ):
            continue
        try:
            fit = fit_recording(arm, corrected.select(rows[rows < corrected.n]))
        except FAILURES:
            continue
        if np.isfinite(fit.scale):
            found.append(Explanation(candidate.correction, fit))
    return _best(found)


def _promising(candidates: list[Candidate]) -> list[Candidate]:
    """The first few candidates whose scale is not far above the smallest."""
    return [c for c in candidates[:_MAX_FITTED] if c.scale <= _PROMISING * candidates[0].scale]


def _best(found):
    return sorted(found, key=lambda e: e.correction.comparable(e.fit.scale))


def _seeds(beam) -> list[Candidate]:
    """The best candidates, and every single sign: a wrong sign is common, and hides behind a second mistake."""
    signs = [
        c for c in beam[_BEAM:] if c.correction.cause == SIGN and c.correction.mistake_count == 1
    ]
    return [*beam[:_BEAM], *signs]


def _of_all_columns(recording, singles) -> list[Candidate]:
    """Corrections of all joint columns, all measured columns or the order of rows.

    Such a mistake hides a second one, and the second one hides it: neither correction alone lowers the misfit.
    """
    kinds = [joint_columns(recording.columns), point_columns(recording), [ROWS]]
    kinds += [QUATERNION] if has_orientation(recording) else []
    wide = [set(names) for names in kinds if names]
    return [Candidate(c, np.inf) for c in singles if any(names <= c.touches for names in wide)]


def _joined(beam: list[Candidate], singles: list[Correction]) -> list[Correction]:
    """Each of the beam with each single correction that it can be joined with, every pair once."""
    beams = {}
    for candidate in beam:
        for single in singles:
            first, second = sorted([candidate.correction, single], key=_is_no_unit)
            both_signs = first.cause == second.cause == SIGN  # screened as sign vectors
            is_disjoint = not first.touches & second.touches
            if not both_signs and (is_disjoint or _is_unit_of_all(first, second)):
                beams.setdefault(frozenset([first.claim, second.claim]), join([first, second]))
    return list(beams.values())


def _is_no_unit(correction: Correction) -> bool:
    return correction.cause not in UNITS


def _is_unit_of_all(first: Correction, second: Correction) -> bool:
    """Whether the first is a unit of all columns that the second one changes in another way."""
    is_unit = first.cause in UNITS and second.cause not in UNITS
    return is_unit and second.touches <= first.touches
