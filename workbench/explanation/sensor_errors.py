"""Errors of a sensor from its diagnosis: by kind, of ball centres, and random errors of single images."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from datasets.recording import Recording
from robot_model.measurements.closure import rigid_fit
from sensors.camera.correlated_errors.displaced_lines import DisplacedLine
from sensors.effects.laser import GhostLine
from sensors.effects.optics import Blooming, FocusBreathing, LensResidual
from sensors.effects.recorded import BoardPointErrors, MirrorVibration
from sensors.scanner.residuals.rejected_points import RejectedPoints
from sensors.stripe.second_line import SecondLine
from workbench.core.effect import Effect
from workbench.diagnosis.levels import CONFIDENCE, CRITICAL_T
from workbench.diagnosis.linear.estimates import parameter_row
from workbench.diagnosis.linear.problem import Alternative, Finding, Found, Problem
from workbench.diagnosis.scanner.image_jitter import find_image_jitter, jitter_before_proof
from workbench.diagnosis.scanner.random_focal_length import LABEL as FOCAL_LENGTH
from workbench.diagnosis.scanner.random_focal_length import (
    find_random_focal_length,
    scatter_next_to,
)
from workbench.diagnosis.validation.held_out import rms
from workbench.explanation.result import Proof, Term
from workbench.explanation.scan_search import find_in_weighed_scans
from workbench.explanation.sentences.statements import LINE_STRUCTURE

_SAME_SPREAD = 0.2  # relative change of the spread of jitter below which a search is not repeated
_SAME_POINTS = "displaces the same points"
_SAME_PROFILE = "makes nearly the same profile of the line"
_AS_WELL = "predicts left-out board poses nearly as well"
_FEWEST_ALIGNED = 4  # centres: three have hardly more freedom than a rigid motion
_ON_A_LINE = 0.01  # of their extent
_KINDS = {"corners": "corners", "board_stripes": "stripes on boards", "balls": "stripes on balls"}


@dataclass(frozen=True)
class LaserLine:
    """Evidence of images about the laser line of a scanner: `rejected` points, a `second_line` or None, and the image's
    `size` px."""

    rejected: RejectedPoints
    second_line: SecondLine | None
    size: tuple[int, int]

    def as_json(self) -> dict:
        """The object `laser_line` of the answer."""
        second = self.second_line
        return {
            "rejected_points": self.rejected.as_json(),
            "second_line": second and second.as_json(),
        }


def laser_line(bench) -> LaserLine | None:
    """Of a scanner whose line has a doubt; None of all others."""
    chains = getattr(bench, "chains", None)
    if chains is None or chains.rejected is None or not chains.line_doubts:
        return None
    return LaserLine(chains.rejected, chains.second_line, chains.corners.camera.size)


def errors_by_kind(bench, proof: Proof, inliers: np.ndarray) -> list[dict]:
    """Held-out RMS errors (px) of corners, stripes on boards and stripes on balls, with the noise of each kind.

    inliers (n,) bool: samples that are no outliers.
    """
    edges = np.cumsum([0, *bench.chains.counts])
    rows = []
    for name, chain, first, last in zip(
        bench.chains.parts, bench.chains.parts.values(), edges, edges[1:]
    ):
        is_of_kind = np.zeros(bench.n, bool)
        is_of_kind[first:last] = True
        before, after = (rms(errors, inliers & is_of_kind) for errors in proof.errors)
        square = (bench.sigma[is_of_kind] ** 2 + bench.shared_px[is_of_kind] ** 2).mean()
        noise = float(np.sqrt(len(chain.sigma) * square))
        rows.append(
            {"kind": _KINDS[name], "before_px": before, "after_px": after, "noise_px": noise}
        )
    return rows


def ball_centres(bench, recording: Recording, terms: Sequence[Term]) -> dict | None:
    """Ball centres (mm, camera frame) of every scan with the baseline and with the final model; None without balls.

    The baseline is the scanner that boards alone calibrate. Both models have a camera frame of their own, and the
    hand-eye transform absorbs the rigid motion between the two: `error_rms_mm` and `error_largest_mm` are what remains
    of the movement after rigid alignment, None where there are too few balls to tell. `distance_error_rms_mm` compares
    distances between balls of one scan with artefact.csv, where there are any.
    """
    before = bench.ball_centres()
    if before is None:
        return None
    after = bench.ball_centres([e for term in terms for e in term.finding.effects])
    numbers = bench.chains.balls.number
    scans = bench.chains.scans
    moved = np.linalg.norm(after - before, axis=1)
    error = _aligned_distances(before, after)
    rows = [
        {
            "scan": scan,
            "ball": int(number) or None,
            "before_mm": old.tolist(),
            "after_mm": new.tolist(),
            "error_mm": distance,
        }
        for scan, number, old, new, distance in zip(scans, numbers, before, after, error)
    ]
    errors = [
        _distance_error(scan_errors, numbers, scans, recording.balls)
        for scan_errors in (before, after)
    ]
    return {
        "moved_rms_mm": float(np.sqrt((moved**2).mean())),
        "moved_largest_mm": float(moved.max()),
        "error_rms_mm": None if None in error else float(np.sqrt(np.square(error).mean())),
        "error_largest_mm": None if None in error else max(error),
        "distance_error_rms_mm": None
        if errors[0] is None
        else {"before": errors[0], "after": errors[1]},
        "centres": rows,
    }


def _aligned_distances(before: np.ndarray, after: np.ndarray) -> list[float | None]:
    """mm between centres before and after (n, 3) each once they are aligned by a rigid motion.

    None where the centres are too few, or all on one line.
    """
    spread = np.linalg.svd(after - after.mean(0), compute_uv=False)
    if len(after) < _FEWEST_ALIGNED or spread[1] < _ON_A_LINE * spread[0]:
        return [None] * len(after)
    rotation, translation = rigid_fit(before, after)
    remainder = after - (before @ rotation.T + translation)
    return np.linalg.norm(remainder, axis=1).tolist()


def with_random_errors(bench, find: Callable[..., Found]) -> tuple[object, Found]:
    """A bench that counts random errors of single images, and what a search finds on it.

    A focal length that differs at random from image to image is tested once, before the search. Random displacement of
    whole stripes is tested before the search, too: against noise alone, jitter passes for many laws of what was
    recorded, none of which predicts another board pose, and a search that accepts them is long. It is tested again next
    to what the search found; only where the spread differs from the first is the search repeated with the new one.
    """
    if bench.chain is not None:
        return find_in_weighed_scans(bench, find)
    focal = find_random_focal_length(bench)
    if focal is not None:
        bench = bench.with_random_focal_length(focal)
    first = find_image_jitter(bench, (), bench.problem(()))
    start = bench if first is None else bench.with_jitter(first.sigma_px)
    found = find(start)
    effects = [effect for finding in found.findings for effect in finding.effects]
    if not effects:
        return start, found
    last = jitter_before_proof(bench, effects, found.before)
    if last is None and first is None:
        return start, found
    sigma = 0.0 if last is None else last.sigma_px
    if abs(sigma - start.jitter_px) < _SAME_SPREAD * max(sigma, start.jitter_px):
        return start, found
    other = bench.with_jitter(sigma)
    return other, find(other)


def without_jitter(bench):
    """The bench for displacements in px: points of one stripe are independent; of an arm the same bench."""
    return bench if bench.chain is not None else bench.with_jitter(0.0)


def image_terms(bench, terms: Sequence[Term], problem: Problem) -> tuple[Term, ...]:
    """Effects in images beyond the retained terms: displaced lines of the board, jitter, and structure of the
    laser line that nothing explains; of an arm nothing."""
    if bench.chain is not None:
        return ()
    effects = [effect for term in terms for effect in term.finding.effects]
    lines = displaced_line_terms(bench, effects)
    jitter = find_image_jitter(bench, effects, problem)
    if jitter is not None:
        finding = jitter.finding if bench.focal is None else _or_focal_length(jitter.finding)
        finding = _or_vibration(finding) if bench.kind.mirror else finding
        lines = (*lines, Term(finding, jitter.parameters, jitter.sigma_px))
    focal = bench.focal
    if focal is not None:
        lines = (*lines, Term(focal.finding, focal.parameters, focal.scatter.shift_px))
    if lines or effects:
        return (*lines, *ghost_line_terms(bench, effects))
    return (*ghost_line_terms(bench, effects), *line_structure_terms(bench))


def _or_vibration(jitter: Finding) -> Finding:
    """Jitter with the alternative of a vibration whose frequency the times of the images do not show."""
    why = "is random from image to image where its frequency is not found in the times of the images (time_s)"
    description = (MirrorVibration.effect, "mirror", "", 0.0, 1.0, why)
    return replace(jitter, alternatives=(*jitter.alternatives, Alternative(*description)))


def _or_focal_length(jitter: Finding) -> Finding:
    """Jitter next to a random focal length, which may be larger in the images with the laser than on boards."""
    description = (
        FocusBreathing.effect,
        "camera",
        FOCAL_LENGTH,
        0.5,
        1.0,
        "displaces whole stripes, too",
    )
    return replace(jitter, probability=0.5, alternatives=(Alternative(*description),))


def line_structure_terms(bench) -> tuple[Term, ...]:
    """Structure of the laser line that no effect of the catalogue makes: the calibration found it in the images.

    Where an effect displaces the line, the calibration, which knows none, takes points of it for wrong. An asymmetric
    profile is a ghost line, see `ghost_line_terms`.
    """
    suspicions = [
        suspicion for suspicion in bench.chains.line_doubts if suspicion.suspect is not GhostLine
    ]
    blooming = [suspicion for suspicion in suspicions if suspicion.suspect is Blooming]
    others = [_of_suspicion(suspicion) for suspicion in suspicions if suspicion.suspect is None]
    return (*map(_of_blooming, blooming[:1]), *others)


def _of_suspicion(suspicion) -> Term:
    description = (
        suspicion.where,
        LINE_STRUCTURE + suspicion.label,
        (),
        suspicion.p_value,
        0.0,
        0.0,
        0.0,
    )
    return Term(Finding("unknown", *description, suspicion.depends_on), size=suspicion.size_px)


def _of_blooming(suspicion) -> Term:
    """Blooming that no held-out board pose confirms, since the points that it displaces most were left out."""
    p_value = max(suspicion.p_value, 1e-300)
    other = Alternative("unknown", "camera", "overexposed line", 0.5, 1.0, _SAME_POINTS)
    description = (
        Blooming.effect,
        "camera",
        LINE_STRUCTURE + suspicion.label,
        (),
        p_value,
        0.5,
        0.0,
        0.0,
    )
    finding = Finding(*description, depends_on=suspicion.depends_on, alternatives=(other,))
    return Term(finding, size=suspicion.size_px)


def ghost_line_terms(bench, effects: Sequence[Effect]) -> tuple[Term, ...]:
    """A second line where the profile of the laser line is asymmetric, unless blooming makes it so.

    A beam that is itself asymmetric makes nearly the same profile: it is the alternative.
    """
    second = bench.chains.second_line
    suspicions = [
        suspicion for suspicion in bench.chains.line_doubts if suspicion.suspect is GhostLine
    ]
    if second is None or not suspicions or any(isinstance(e, Blooming) for e in effects):
        return ()
    ghost = GhostLine("laser")
    scale = float(np.median(bench.chains.board_stripes.gain))  # mm along the normal of the plane
    sizes = (
        ("share", "brightness over that of the line", "1", second.share, second.std[0]),
        ("offset", "distance from the line", "px", second.offset_px, second.std[1]),
        (
            "offset_mm",
            "distance along the normal of the light plane",
            "mm",
            scale * second.offset_px,
            scale * second.std[1],
        ),
    )
    rows = tuple(
        {
            "key": f"laser.{ghost.effect}.{name}",
            "name": name,
            "where": "laser",
            "label": label,
            "effect": ghost.effect,
            "value": float(value),
            "std": float(std),
            "unit": unit,
            "typical": 0.1,
            "size_px": abs(second.shift_px),
        }
        for name, label, unit, value, std in sizes
    )
    beam = Alternative(
        "unknown", "laser", "an asymmetric beam", 1 - second.probability, 1.0, _SAME_PROFILE
    )
    others = (beam,) if second.probability < CONFIDENCE else ()
    description = (
        ghost.effect,
        "laser",
        "",
        (),
        suspicions[0].p_value,
        second.probability,
        0.0,
        0.0,
    )
    finding = Finding(*description, depends_on=suspicions[0].depends_on, alternatives=others)
    return (Term(finding, rows, abs(second.shift_px)),)


def displaced_line_terms(bench, effects: Sequence[Effect]) -> tuple[Term, ...]:
    """Rows or columns of the board that the calibration of the camera found displaced, but for those of `effects`.

    Their points contradict all others of a board pose, so that they are not among the corners of the bench, and nothing
    is left of them for a search. Kept are those that reduce the error of board poses that were left out.
    """
    known = {(e.line, round(e.at_mm, 3)) for e in effects if isinstance(e, BoardPointErrors)}
    scale = bench.chains.corners.camera.fx / float(np.median(bench.covariates["range"]))
    confirmed = [
        line for line in bench.chains.lines if line.held_out and line.held_out.t > CRITICAL_T
    ]
    found = [_of_line(line, scale) for line in confirmed]
    return tuple(term for key, term in found if key not in known)


def _of_line(found: DisplacedLine, px_per_mm: float) -> tuple[tuple[str, float], Term]:
    """Name of a displaced line, and its term."""
    kind = "column" if found.line.axis == 0 else "row"
    effect = BoardPointErrors("artefact", kind, float(found.line.at_mm))
    values = zip(effect.table(None), found.shift.tolist(), found.std.tolist())
    rows = tuple(
        parameter_row(p, effect, value, std, std) | {"size_px": abs(value) * px_per_mm}
        for p, value, std in values
    )
    label = f"{kind} at {effect.at_mm:g} mm"
    squares = float(((found.shift / found.std) ** 2).sum())
    p_value = max(float(chdtrc(2, squares)), 1e-300)
    tested = found.held_out
    probability = tested.probability
    others = (
        Alternative(
            effect.effect, effect.where, "another row or column", 1 - probability, 1.0, _AS_WELL
        ),
    )
    finding = Finding(
        effect.effect,
        effect.where,
        label,
        (),
        p_value,
        probability,
        0.0,
        squares,
        alternatives=others if probability < CONFIDENCE else (),
    )
    term = Term(
        finding,
        rows,
        size=float(np.linalg.norm(found.shift)) * px_per_mm,
        t=tested.t,
        gain=tested.rms[0] - tested.rms[1],
        reselected_folds=tested.reselected,
        searched_folds=tested.poses,
    )
    return (kind, round(effect.at_mm, 3)), term


def image_warnings(bench, terms: Sequence[Term]) -> tuple[str, ...]:
    """Warnings about images: displaced lines of the board, the laser line itself, and a focal length that
    differs from board pose to board pose."""
    chains = bench.chains
    warnings = []
    if chains.lines:
        lines = ", ".join(line.sentence for line in chains.lines)
        warnings.append(
            f"The board errs ({BoardPointErrors.effect}): the calibration of the camera finds {lines}; measure or "
            "replace the board. Corners that contradict all others are left out of this diagnosis."
        )
    warnings += [line_doubt.sentence for line_doubt in chains.line_doubts]
    if chains.beyond_lens:
        warnings.append(
            f"{chains.beyond_lens} points of laser lines are left out: they lie beyond the angles that the camera "
            "model reaches, which the corners of the boards determine; show boards up to the edge of the image"
        )
    focal = "" if bench.focal is not None else random_focal_error(bench, terms)
    return (*warnings, focal) if focal else tuple(warnings)


def random_focal_error(bench, terms: Sequence[Term]) -> str:
    """A sentence where the focal length differs from board pose to board pose, "" where it does not."""
    effects = tuple(e for term in terms for e in term.finding.effects)
    found = scatter_next_to(bench, effects)
    if found is None or not found.significant:
        return ""
    other = (
        ""
        if any(isinstance(effect, LensResidual) for effect in effects)
        else "; or the lens is not of the model fitted, which looks alike where boards fill only a part of the image"
    )
    return f"{found.sentence[0].upper()}{found.sentence[1:]}{other}."


def _distance_error(
    centres: np.ndarray, numbers: np.ndarray, scans: Sequence[str], known: Mapping[int, tuple]
) -> float | None:
    """RMS difference (mm) of distances between named balls of one scan from the certificate's; None without pairs."""
    squares = []
    for i in range(len(centres)):
        for j in range(i):
            if scans[i] != scans[j] or not numbers[i] or not numbers[j]:
                continue
            places = [np.asarray(known[int(numbers[k])][:3]) for k in (i, j)]
            certified = np.linalg.norm(places[0] - places[1])
            squares.append((np.linalg.norm(centres[i] - centres[j]) - certified) ** 2)
    if squares:
        return float(np.sqrt(np.mean(squares)))
    return None
