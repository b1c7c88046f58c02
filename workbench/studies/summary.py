"""Summary of a study: distribution of each column, sensitivity of the outcome, coverage of the stated sigmas."""

from collections import Counter

import numpy as np

from workbench.core.errors import InputError
from workbench.studies import tables
from workbench.studies.spec import Axis, Study
from workbench.studies.variation import problem, unit_of

_MIN_RUNS = 80
"""Number of runs below which sensitivity indices are mostly noise."""
_QUANTILES = {"min": 0, "p5": 5, "median": 50, "p95": 95, "max": 100}


def summary(study_run) -> dict:
    """The answer of `workbench study` for a `workbench.studies.study.Finished` with its table."""
    study = study_run.study
    names = tables.column_names(study_run.path)
    outcomes = tables.columns(study_run.path, ["outcome"])["outcome"]
    done = int((outcomes == "done").sum())
    if not done:
        raise InputError(
            f"study {study_run.name}: all {len(outcomes)} runs failed, the first because: {outcomes[0]}. "
            "Correct the study"
        )
    failures = Counter(text for text in outcomes if text != "done")
    found = {
        "command": "study",
        "study": study_run.name,
        "title": study.title or study_run.name,
        "kind": study.kind,
        "do": study.do,
        "runs": len(outcomes),
        "done": done,
        "not_done": [{"why": why, "runs": n} for why, n in failures.most_common(10)],
        "varied": [axis.name for axis in study.vary.parameter],
        "outcome": outcome_of(study, names),
        "columns": [spread(name, values) for name, values in _numbers(study_run, names)],
        "stiffen": stiffening(study_run, names),
        "sensitivity": sensitivity(study_run, names),
        "coverage": coverage(study_run, names),
        "work": _work(study_run.done),
    }
    remarks = []
    if study.outcome not in (None, found["outcome"]):
        remarks.append(
            f"There is no column {study.outcome} (key outcome); {found['outcome']} is shown instead."
        )
    return found | {"sentences": remarks + sentences(found)}


def _work(done) -> dict:
    return {
        "runs_made_now": done.made,
        "seconds_of_runs": done.seconds,
        "seconds": done.wall,
        "workers": done.workers,
        "overhead": done.overhead,
    }


def _numbers(study_run, names):
    """Name and values of each numeric column, one in memory at a time."""
    axes = {axis.name for axis in study_run.study.vary.parameter}
    for name in names:
        if name not in axes | {"run", "outcome"}:
            values = tables.columns(study_run.path, [name])[name]
            if values.dtype != object and np.isfinite(values).any():
                yield name, values


def spread(name: str, values: np.ndarray) -> dict:
    """Mean, standard deviation and quantiles of the runs that have a value."""
    finite = values[np.isfinite(values)]
    row = {
        "column": name,
        "n": len(finite),
        "mean": float(finite.mean()),
        "std": float(finite.std(ddof=1)) if len(finite) > 1 else None,
    }
    quantiles = np.percentile(finite, list(_QUANTILES.values())).tolist()
    return row | dict(zip(_QUANTILES, quantiles))


def outcome_of(study: Study, names: list[str]) -> str:
    """The outcome column: that of the study file if it exists, else by the kind of study."""
    if study.outcome in names:
        return study.outcome
    last = study.models[-1].rpartition("/")[2].removesuffix(".toml")
    ends = {
        "compliance": [f"{last}_tasks_mm", "uncalibrated_tasks_mm", f"{last}_test_mm"],
        "sensor": ["centre_rms_mm", "form_rms_mm"],
        "uncertainty": [f"{last}_tasks_mm", f"{last}_test_mm"],
        "design": [f"{last}_tasks_mm", f"{last}_test_mm"],
    }
    wanted = [*ends[study.kind], f"{last}_held_out_mm", *(n for n in names if n.endswith("_mm"))]
    return next((name for name in wanted if name in names), "run")


def numeric(axis: Axis) -> bool:
    """True if the values of a parameter are numbers."""
    return axis.values is None or all(isinstance(value, int | float) for value in axis.values)


def stiffening(study_run, names: list[str]) -> list[dict]:
    """For each compliant joint: error with this joint twice as stiff, relative to the present error."""
    mark = "_twice_as_stiff_"
    found = [name for name in names if mark in name]
    if not found:
        return []
    place = found[0].partition(mark)[2].removesuffix("_mm")
    values = tables.columns(study_run.path, [*found, f"uncalibrated_{place}_mm"])
    before = values.pop(f"uncalibrated_{place}_mm")
    share = np.stack([values[name] / before for name in found])
    fine = np.isfinite(share).all(0)
    best = share[:, fine].argmin(0)
    return [
        {
            "joint": name.partition(mark)[0],
            "at": place,
            "error_left": float(share[k, fine].mean()),
            "error_left_p5": float(np.percentile(share[k, fine], 5)),
            "error_left_p95": float(np.percentile(share[k, fine], 95)),
            "best_in": float((best == k).mean()),
        }
        for k, name in enumerate(found)
    ]


def sensitivity(study_run, names: list[str]) -> dict:
    """Variance-based sensitivity indices of the outcome.

    Saltelli's scheme: first-order and total indices (Saltelli et al., Comput. Phys. Commun. 181 (2010) 259). Any other
    sample: first-order indices by random balance designs (Tarantola, Gatelli & Mara, Reliab. Eng. Syst. Saf. 91 (2006)
    717). Both by SALib; `why` gives the reason if they are not available.
    """
    axes = [axis for axis in study_run.study.vary.parameter if numeric(axis)]
    outcome = outcome_of(study_run.study, names)
    if not axes or len(axes) < len(study_run.study.vary.parameter):
        return {"why": "not determined: needs parameters that are all numbers"}
    values = tables.columns(study_run.path, [outcome, *(axis.name for axis in axes)])
    result = values.pop(outcome)
    fine = np.isfinite(result)
    if study_run.study.vary.repeats > 1 or study_run.study.vary.method == "grid":
        return {
            "why": "not determined: needs a random, Latin hypercube, Sobol or Saltelli sample without repeats"
        }
    if fine.sum() < _MIN_RUNS:
        return {
            "why": f"not determined: {fine.sum()} runs are too few, expected at least {_MIN_RUNS}"
        }
    try:
        return _indices(study_run.study, axes, values, result, fine) | {"outcome": outcome}
    except ImportError:
        return {
            "why": "not determined: needs the package SALib (pip install 'vision-sensor-workbench[study]')"
        }


def _indices(study: Study, axes, values, result, fine) -> dict:
    names = [axis.name for axis in axes]
    if study.vary.method == "saltelli":
        if not fine.all():
            return {
                "why": f"not determined: Saltelli's scheme needs every run, and {(~fine).sum()} failed"
            }
        from SALib.analyze import sobol

        # the mean is subtracted: a large mean degrades the estimators
        indices_of_result = sobol.analyze(
            problem(len(axes)), result - result.mean(), calc_second_order=False, seed=study.seed
        )
        rows = zip(
            names,
            indices_of_result["S1"],
            indices_of_result["S1_conf"],
            indices_of_result["ST"],
            indices_of_result["ST_conf"],
        )
        keys = ("parameter", "first", "first_95", "total", "total_95")
        return {
            "method": "Sobol indices",
            "indices": [dict(zip(keys, map(_plain, row))) for row in rows],
        }
    from SALib.analyze import rbd_fast

    unit = np.stack([unit_of(axis, values[axis.name][fine]) for axis in axes], 1)
    indices_of_result = rbd_fast.analyze(problem(len(axes)), unit, result[fine], seed=study.seed)
    rows = zip(names, indices_of_result["S1"], indices_of_result["S1_conf"])
    keys = ("parameter", "first", "first_95")
    return {
        "method": "random balance designs",
        "indices": [dict(zip(keys, map(_plain, row))) for row in rows],
    }


def _plain(value):
    return value if isinstance(value, str) else float(value)


def coverage(study_run, names: list[str]) -> list[dict]:
    """For each parameter with a sigma: scatter of its values over the runs, compared with the stated sigma.

    In a parametric bootstrap the true value is known: `within_1`, `within_2` are the shares of runs with the true value
    within 1 and 1.96 stated sigmas (expected 0.683 and 0.95). In a bootstrap of poses it is not known; `ratio` is the
    standard deviation over the runs divided by the sigma of the whole recording.
    """
    study = study_run.study
    if study.recording is None or not study.parameters or "calibrate" not in study.do:
        return []
    from pathlib import Path

    from workbench.studies.resampling import fitted
    from workbench.studies.robots import parameter_row

    full_models = {
        Path(name).stem: fitted(study.recording, name, study.folds) for name in study.models
    }
    true = parameter_row(full_models, same_arm=True)
    # the true values are those of the first model, to which the noise is added
    if study.resample.how == "noise":
        true_model = f"{Path(study.models[0]).stem}:"
    else:
        true_model = None
    rows = []
    for key in [name for name in names if f"{name}:std" in names and true.get(f"{name}:std")]:
        values = tables.columns(study_run.path, [key, f"{key}:std"])
        rows.append(
            _covered(
                key,
                values[key],
                values[f"{key}:std"],
                true[key],
                true[f"{key}:std"],
                true_model is not None and key.startswith(true_model),
            )
        )
    return [row for row in rows if row is not None]


def _covered(key, values, std, true, stated, known) -> dict | None:
    fine = np.isfinite(values) & np.isfinite(std)
    if fine.sum() < 2:
        return None
    row = {
        "parameter": key,
        "n": int(fine.sum()),
        "whole": true,
        "whole_std": stated,
        "spread": float(values[fine].std(ddof=1)),
        "ratio": float(values[fine].std(ddof=1) / stated),
    }
    if known:
        sigmas = np.abs(values[fine] - true) / std[fine]
        row |= {
            "within_1": float((sigmas <= 1).mean()),
            "within_2": float((sigmas <= 1.96).mean()),
            "bias_sigmas": float((values[fine] - true).mean() / stated),
        }
    return row


def sentences(found: dict) -> list[str]:
    """The main results as sentences."""
    lines = []
    if found["not_done"]:
        first = found["not_done"][0]
        lines.append(
            f"{found['runs'] - found['done']} runs failed, {first['runs']} of them because: {first['why']}"
        )
    if found["stiffen"]:
        best = min(found["stiffen"], key=lambda row: row["error_left"])
        lines.append(
            f"{best['joint'].replace('-', ' ').capitalize()} is the joint to stiffen: with twice its stiffness, the "
            f"error at {best['at'].replace('_', ' under ')} falls to {100 * best['error_left']:.0f} % on average. It "
            f"is the best choice in {100 * best['best_in']:.0f} % of the runs."
        )
    if indices := found["sensitivity"].get("indices"):
        dominant = max(indices, key=lambda row: row.get("total", row["first"]))
        share = dominant.get("total", dominant["first"])
        lines.append(
            f"{dominant['parameter']} has the largest influence on {found['outcome']}: "
            f"{100 * share:.0f} % of its variance."
        )
    known = [row for row in found["coverage"] if "within_2" in row]
    if known:
        mean = np.mean([row["within_2"] for row in known])
        lines.append(
            f"95 % intervals of {len(known)} parameters contain the true value in {100 * mean:.1f} % of the runs."
        )
    elif found["coverage"]:
        ratio = np.median([row["ratio"] for row in found["coverage"]])
        lines.append(
            f"The standard deviation of parameters over resampled recordings is {ratio:.2f} times their stated "
            "sigma (median)."
        )
    return lines
