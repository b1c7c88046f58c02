"""Run folders of diagnoses, written as `workbench diagnose` writes them, for tests of the app."""

import json
from pathlib import Path

_SHARED = {
    "variant": "",
    "depends_on": [],
    "options": {},
    "alarms": [],
    "alternatives": [],
    "parameters": [],
    "controls": [],
    "found_again": {"folds": 9, "of": 9},
}
_LINK = {
    "effect": "link-compliance",
    "where": "link-1",
    "variant": "",
    "why": "it makes 87 % of the same signature",
    "probability": 0.01,
    "alike": 0.87,
    "not_recorded": "",
}
_KEPT = {
    **_SHARED,
    "effect": "joint-compliance",
    "where": "joint-2",
    "p_value": 3e-31,
    "probability": 0.99,
    "alternatives": [_LINK],
    "parameters": [{"name": "compliance", "value": 2e-5, "std": 4e-7, "unit": "rad/(N m)"}],
    "controls": [{"control": "permuted", "p_value": 0.005, "passed": True, "why": ""}],
    "size_mm": 0.36,
    "t": 7.7,
    "held_out_gain_mm": 0.08,
    "statement": "Joint 2 deflects under the gravity torque.",
}
_REFUSED = {
    **_SHARED,
    "effect": "backlash",
    "where": "joint-5",
    "p_value": 2e-3,
    "probability": 0.6,
    "size_mm": 0.01,
    "t": 1.1,
    "held_out_gain_mm": 0.0,
    "statement": "Joint 5 stops short.",
    "reason": "the held-out error does not fall",
}


def diagnosis_answer() -> dict:
    """A diagnosis of the bundled arm as `workbench diagnose` writes it, with one term kept and one refused."""
    places = (("joint-2", 0.59, 1e-99), ("link-1", 0.5, 1e-80), ("joint-5", 0.1, 0.4))
    located = [{"where": w, "share_of_mismatch": share, "p_value": p} for w, share, p in places]
    return {
        "command": "diagnose",
        "recording": "elastic-arm",
        "input": "elastic-arm",
        "samples": 300,
        "verdict": "explained",
        "unit": "mm",
        "effects": [dict(_KEPT)],
        "refused": [dict(_REFUSED)],
        "located": located,
        "next_experiment": "Measure 2 poses more.",
        "held_out": {"before_mm": 0.117, "after_mm": 0.039, "noise_mm": 0.035, "folds": 4},
    }


def write_diagnosis(folder: Path) -> Path:
    """A run folder of a diagnosis, with residuals of all samples and the poses of a next experiment."""
    import numpy as np

    import datasets

    folder.mkdir(parents=True)
    (folder / "answer.json").write_text(json.dumps(diagnosis_answer()), encoding="utf-8")
    ids = datasets.read("elastic-arm").sample_ids
    vectors = np.random.default_rng(5).normal(0, 0.03, (len(ids), 6))
    head = "sample," + ",".join(
        f"{when}_{axis}_mm" for when in ("before", "after") for axis in "xyz"
    )
    head += ",held_out_before_mm,held_out_after_mm"
    table = np.column_stack([ids, vectors, np.abs(vectors[:, :2]) + 0.1])
    np.savetxt(folder / "residuals.csv", table, fmt="%.6g", delimiter=",", header=head, comments="")
    poses = (
        "joint 1,joint 2,joint 3,joint 4,joint 5,joint 6\n10,20,-10,5,-60,0\n-30,10,-20,15,-70,40\n"
    )
    (folder / "next-experiment-poses.csv").write_text(poses, encoding="utf-8")
    return folder


def image_diagnosis_answer(recording: Path) -> dict:
    """A diagnosis of the images of a scanner: the board is not flat."""
    bow = {
        **_SHARED,
        "effect": "board-bow",
        "where": "artefact",
        "p_value": 3e-299,
        "probability": 1.0,
        "size_px": 0.064,
        "t": 6.8,
        "held_out_gain_px": 0.0158,
        "statement": "The calibration board is not flat.",
    }
    places = (("artefact", 0.7, 4e-299), ("laser", 0.12, 1e-77), ("camera", 0.08, 1e-60))
    located = [{"where": w, "share_of_mismatch": share, "p_value": p} for w, share, p in places]
    return {
        "command": "diagnose",
        "input": str(recording),
        "verdict": "explained",
        "unit": "px",
        "effects": [bow],
        "refused": [],
        "located": located,
        "next_experiment": "",
        "held_out": {"before_px": 0.0341, "after_px": 0.0154, "folds": 5},
    }


def write_image_diagnosis(folder: Path, scanner_run: Path) -> Path:
    """A run folder of a diagnosis of images: 300 corners, and 100 stripe points with one coordinate."""
    import numpy as np

    folder.mkdir(parents=True)
    answer = image_diagnosis_answer(scanner_run.parent / "recording")
    (folder / "answer.json").write_text(json.dumps(answer), encoding="utf-8")
    vectors = np.random.default_rng(6).normal(0, 0.03, (400, 4))
    vectors[300:, [1, 3]] = np.nan
    head = "sample,before_u_px,before_v_px,after_u_px,after_v_px"
    table = np.column_stack([np.arange(400), vectors])
    np.savetxt(folder / "residuals.csv", table, fmt="%.6g", delimiter=",", header=head, comments="")
    return folder
