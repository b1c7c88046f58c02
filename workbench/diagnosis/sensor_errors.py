"""What a diagnosis of a sensor means for the user: errors by kind of measurement, and ball centres before and after."""

from collections.abc import Mapping, Sequence

import numpy as np

from datasets.recording import Recording
from workbench.diagnosis.heldout import rms
from workbench.diagnosis.result import Proof, Term

_KINDS = {"corners": "corners", "sheets": "stripes on boards", "balls": "stripes on balls"}


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
