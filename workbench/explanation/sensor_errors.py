"""What a diagnosis of a sensor means for the user: errors by kind, ball centres, random errors of single images."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from datasets.recording import Recording
from sensors.camera.focal_scatter import focal_scatter
from workbench.core.effect import Effect
from workbench.core.least_squares.adjustment_tests import neighbour_test
from workbench.core.model import Model
from workbench.diagnosis.scanner.sensor_linear import acts
from workbench.diagnosis.validation.heldout import rms
from workbench.explanation.result import Proof, Term
from workbench.jobs.sensor.chains import at_solution

_LEVEL = 1e-3
_RELEVANT = 1.0  # of the noise of a stripe's averaged point, from which a displacement of whole stripes matters
_FEWEST_STRIPES = 20
_KINDS = {"corners": "corners", "board_stripes": "stripes on boards", "balls": "stripes on balls"}


def errors_by_kind(bench, proof: Proof, usual: np.ndarray) -> list[dict]:
    """Held-out RMS errors (px) of corners, stripes on boards and stripes on balls, with the noise of each kind.

    usual (n,) bool: samples that are no outliers.
    """
    edges = np.cumsum([0, *bench.chains.counts])
    rows = []
    for name, chain, first, last in zip(
        bench.chains.parts, bench.chains.parts.values(), edges, edges[1:]
    ):
        mine = np.zeros(bench.n, bool)
        mine[first:last] = True
        before, after = (rms(errors, usual & mine) for errors in proof.errors)
        noise = float(np.sqrt(len(chain.sigma) * (bench.sigma[mine] ** 2).mean()))
        rows.append(
            {"kind": _KINDS[name], "before_px": before, "after_px": after, "noise_px": noise}
        )
    return rows


def ball_centres(bench, recording: Recording, terms: Sequence[Term]) -> dict | None:
    """Ball centres (mm, camera frame) of every scan with the baseline and with the final model; None without balls.

    `distance_error_rms_mm` compares distances between balls of one scan with artefact.csv, where there are any.
    """
    before = bench.ball_centres()
    if before is None:
        return None
    after = bench.ball_centres([e for term in terms for e in term.finding.effects])
    numbers, scans = bench.chains.balls.number, bench.chains.scans
    moved = np.linalg.norm(after - before, axis=1)
    rows = [
        {
            "scan": scan,
            "ball": int(number) or None,
            "before_mm": old.tolist(),
            "after_mm": new.tolist(),
        }
        for scan, number, old, new in zip(scans, numbers, before, after)
    ]
    errors = [_distance_error(one, numbers, scans, recording.balls) for one in (before, after)]
    return {
        "moved_rms_mm": float(np.sqrt((moved**2).mean())),
        "moved_largest_mm": float(moved.max()),
        "distance_error_rms_mm": None
        if errors[0] is None
        else {"before": errors[0], "after": errors[1]},
        "centres": rows,
    }


def random_image_error(bench, terms: Sequence[Term]) -> str:
    """A sentence where whole stripes are displaced at random from image to image, "" where they are not.

    The means of single stripes scatter by more than their own noise (chi-square test), and depend neither on the step
    nor on the board pose nor on the order of the images: no law of a recorded covariate predicts that.
    """
    board_stripes = bench.chains.board_stripes
    if board_stripes is None:
        return ""
    residual = _stripe_residual(bench, [e for term in terms for e in term.finding.effects])
    labels = board_stripes.labels
    code = labels["placement"] * board_stripes.planes.shape[1] + labels["step"]
    _, first, stripe = np.unique(code, return_index=True, return_inverse=True)
    weight = np.broadcast_to(board_stripes.sigma, (1, board_stripes.n))[0] ** -2.0
    total = np.bincount(stripe, weight)
    means = np.bincount(stripe, weight * residual) / total
    size = _scatter(means, total)
    if size < _RELEVANT * float(np.median(weight**-0.5)) or len(means) < _FEWEST_STRIPES:
        return ""
    groups = [labels["step"][first], labels["placement"][first]]
    if any(_depends(means, group) for group in groups) or _drifts(
        means, bench.order[_of(bench)][first]
    ):
        return ""
    return (
        f"Whole stripes are displaced at random from image to image by {size:.2g} px (1 sigma): jitter or vibration of "
        "the mirror or the arm, or irregular timing. No recorded covariate predicts it, so no correction can remove "
        "it; average several sweeps, let the arm settle, or record what changes between images."
    )


def _stripe_residual(bench, effects: Sequence[Effect]) -> np.ndarray:
    """(n,) px, residuals of stripes on boards with the errors that the points of a stripe share.

    A fit takes these errors off, as random effects; here they are what is looked for.
    """
    chains, fit = bench.solve(effects)
    whole = replace(at_solution(chains, fit).board_stripes, together=None)
    model = Model(whole, tuple(effect for effect in effects if acts(effect, "board_stripes")))
    keys = set(model.parameters.keys)
    found = {p.key: fit.parameters[p.key] for p in fit.parameters.table if p.key.count(".") > 1}
    values = {key: value for key, value in found.items() if key in keys}
    return model.evaluate(model.parameters.update(values)).residual[0]


def random_focal_error(bench, terms: Sequence[Term]) -> str:
    """A sentence where the focal length differs from board pose to board pose, "" where it does not."""
    effects = [e for term in terms for e in term.finding.effects]
    chains, fit = bench.solve(effects)
    on_corners = tuple(effect for effect in effects if acts(effect, "corners"))
    found = focal_scatter(at_solution(chains, fit).corners, fit, on_corners)
    if found is None or not found.significant:
        return ""
    return f"{found.sentence[0].upper()}{found.sentence[1:]}."


def _of(bench) -> slice:
    """Where the stripes on boards stand among the samples of a bench."""
    first = bench.chains.counts[0]
    return slice(first, first + bench.chains.board_stripes.n)


def _scatter(means: np.ndarray, weight: np.ndarray) -> float:
    """Standard deviation (px) of the stripes' own displacement; 0 where their noise explains the scatter.

    Method of moments: DerSimonian and Laird, Controlled Clinical Trials 7 (1986).
    """
    from scipy.special import chdtrc

    away = means - np.average(means, weights=weight)
    degrees = len(means) - 1
    statistic = float(weight @ away**2)
    if chdtrc(degrees, statistic) > _LEVEL:
        return 0.0
    unit = weight.sum() - (weight**2).sum() / weight.sum()
    return float(np.sqrt(max(statistic - degrees, 0.0) / unit))


def _depends(means: np.ndarray, group: np.ndarray) -> bool:
    """One-way analysis of variance: whether the means of stripes differ between groups."""
    from scipy.stats import f_oneway

    parts = [means[group == label] for label in np.unique(group)]
    parts = [part for part in parts if len(part) > 1]
    return len(parts) > 1 and bool(f_oneway(*parts).pvalue < _LEVEL)


def _drifts(means: np.ndarray, order: np.ndarray) -> bool:
    """Whether stripes that follow one another are displaced alike (von Neumann's ratio)."""
    ordered = np.argsort(order, kind="stable")
    previous = np.maximum(np.arange(len(means)) - 1, 0)
    previous[0] = 1
    return neighbour_test(means[ordered][None], previous).p_value < _LEVEL


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
    return float(np.sqrt(np.mean(squares))) if squares else None
