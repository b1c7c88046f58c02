"""What a study says: how each column is spread, what its outcome depends on, and whether stated sigmas hold."""

from collections import Counter

import numpy as np

from workbench.core.errors import InputError
from workbench.study import tables
from workbench.study.spec import Axis, Study
from workbench.study.variation import problem, unit_of

_LEAST = 80
"""Runs below which indices of sensitivity are mostly noise."""
_QUANTILES = {"min": 0, "p5": 5, "median": 50, "p95": 95, "max": 100}


def summary(made) -> dict:
    """The answer of `workbench study`, of a `workbench.study.study.Finished` whose table is there."""
    study, names = made.study, tables.column_names(made.path)
    outcomes = tables.columns(made.path, ["outcome"])["outcome"]
    done = int((outcomes == "done").sum())
    if not done:
        raise InputError(
            f"study {made.name}: expected runs that can be done, found none of {len(outcomes)} "
            f"({outcomes[0]}); correct the study"
        )
    told = Counter(text for text in outcomes if text != "done")
    found = {
        "command": "study",
        "study": made.name,
        "title": study.title or made.name,
        "kind": study.kind,
        "do": study.do,
        "runs": len(outcomes),
        "done": done,
        "not_done": [{"why": why, "runs": n} for why, n in told.most_common(10)],
        "varied": [axis.name for axis in study.vary.parameter],
        "outcome": outcome_of(study, names),
        "columns": [spread(name, values) for name, values in _numbers(made, names)],
        "stiffen": stiffening(made, names),
        "sensitivity": sensitivity(made, names),
        "coverage": coverage(made, names),
        "work": _work(made.done),
    }
    odd = study.outcome not in (None, found["outcome"])
    told = (
        [
            f"No column is called {study.outcome}, as key outcome says; {found['outcome']} is shown "
            "instead."
        ]
        if odd
        else []
    )
    return found | {"sentences": told + sentences(found)}


def _work(done) -> dict:
    return {
        "runs_made_now": done.made,
        "seconds_of_runs": done.seconds,
        "seconds": done.wall,
        "workers": done.workers,
        "overhead": done.overhead,
    }


def _numbers(made, names):
    """Name and values of each column of numbers, one in memory at a time."""
    axes = {axis.name for axis in made.study.vary.parameter}
    for name in names:
        if name not in axes | {"run", "outcome"}:
            values = tables.columns(made.path, [name])[name]
            if values.dtype != object and np.isfinite(values).any():
                yield name, values


def spread(name: str, values: np.ndarray) -> dict:
    """Mean, standard deviation and quantiles of the runs that have a value."""
    there = values[np.isfinite(values)]
    row = {
        "column": name,
        "n": len(there),
        "mean": float(there.mean()),
        "std": float(there.std(ddof=1)) if len(there) > 1 else None,
    }
    return row | dict(zip(_QUANTILES, np.percentile(there, list(_QUANTILES.values())).tolist()))


def outcome_of(study: Study, names: list[str]) -> str:
    """The column that the study is about: as its file says, where there is one, else by its kind."""
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
    """Whether a parameter's values are numbers on a line."""
    return axis.values is None or all(isinstance(value, int | float) for value in axis.values)


def stiffening(made, names: list[str]) -> list[dict]:
    """For each joint that yields: the error left with that joint twice as stiff, over the error as it is."""
    mark = "_twice_as_stiff_"
    found = [name for name in names if mark in name]
    if not found:
        return []
    place = found[0].partition(mark)[2].removesuffix("_mm")
    values = tables.columns(made.path, [*found, f"uncalibrated_{place}_mm"])
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


def sensitivity(made, names: list[str]) -> dict:
    """How much of the outcome's variance each parameter makes, alone and together with others.

    Saltelli's scheme: first-order and total indices (Saltelli et al., Comput. Phys. Commun. 181 (2010) 259). Any other
    sample: first-order indices by random balance designs (Tarantola, Gatelli & Mara, Reliab. Eng. Syst. Saf. 91 (2006)
    717). Both by SALib; where they cannot be had, `why` says so.
    """
    axes = [axis for axis in made.study.vary.parameter if numeric(axis)]
    outcome = outcome_of(made.study, names)
    if not axes or len(axes) < len(made.study.vary.parameter):
        return {"why": "not determined: needs parameters that are all numbers"}
    values = tables.columns(made.path, [outcome, *(axis.name for axis in axes)])
    result = values.pop(outcome)
    fine = np.isfinite(result)
    if made.study.vary.repeats > 1 or made.study.vary.method == "grid":
        return {
            "why": "not determined: needs a random, Latin hypercube, Sobol or Saltelli sample without repeats"
        }
    if fine.sum() < _LEAST:
        return {"why": f"not determined: {fine.sum()} runs are too few, expected at least {_LEAST}"}
    try:
        return _indices(made.study, axes, values, result, fine) | {"outcome": outcome}
    except ImportError:
        return {
            "why": "not determined: needs the package SALib (pip install 'vision-sensor-workbench[study]')"
        }


def _indices(study: Study, axes, values, result, fine) -> dict:
    names = [axis.name for axis in axes]
    if study.vary.method == "saltelli":
        if not fine.all():
            return {
                "why": f"not determined: Saltelli's scheme needs every run, and {(~fine).sum()} were not done"
            }
        from SALib.analyze import sobol

        # about the mean: the estimators lose digits, and bias, to a large one
        made = sobol.analyze(
            problem(len(axes)), result - result.mean(), calc_second_order=False, seed=study.seed
        )
        rows = zip(names, made["S1"], made["S1_conf"], made["ST"], made["ST_conf"])
        keys = ("parameter", "first", "first_95", "total", "total_95")
        return {
            "method": "Sobol indices",
            "indices": [dict(zip(keys, map(_plain, row))) for row in rows],
        }
    from SALib.analyze import rbd_fast

    unit = np.stack([unit_of(axis, values[axis.name][fine]) for axis in axes], 1)
    made = rbd_fast.analyze(problem(len(axes)), unit, result[fine], seed=study.seed)
    rows = zip(names, made["S1"], made["S1_conf"])
    keys = ("parameter", "first", "first_95")
    return {
        "method": "random balance designs",
        "indices": [dict(zip(keys, map(_plain, row))) for row in rows],
    }


def _plain(value):
    return value if isinstance(value, str) else float(value)


def coverage(made, names: list[str]) -> list[dict]:
    """For each parameter with a sigma: how the runs' values are spread beside what each run states.

    Of new noise about a fitted model the true value is known: `within_1`, `within_2` are the shares of runs that have
    it within 1 and 1.96 of their stated sigmas (0.683 and 0.95 where these hold). Of poses drawn again it is not, and
    `ratio`, the spread over the sigma of the whole recording, is what there is.
    """
    study = made.study
    if study.recording is None or not study.parameters or "calibrate" not in study.do:
        return []
    from pathlib import Path

    from workbench.study.resampling import fitted
    from workbench.study.robots import parameter_row

    whole = {Path(name).stem: fitted(study.recording, name, study.folds) for name in study.models}
    true = parameter_row(whole)
    # values that noise is added to stand only behind the first model
    behind = f"{Path(study.models[0]).stem}:" if study.resample.how == "noise" else None
    rows = []
    for key in [name for name in names if f"{name}:std" in names and true.get(f"{name}:std")]:
        values = tables.columns(made.path, [key, f"{key}:std"])
        rows.append(
            _covered(
                key,
                values[key],
                values[f"{key}:std"],
                true[key],
                true[f"{key}:std"],
                behind is not None and key.startswith(behind),
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
        away = np.abs(values[fine] - true) / std[fine]
        row |= {
            "within_1": float((away <= 1).mean()),
            "within_2": float((away <= 1.96).mean()),
            "bias_sigmas": float((values[fine] - true).mean() / stated),
        }
    return row


def sentences(found: dict) -> list[str]:
    """The main points, for a person."""
    lines = []
    if found["not_done"]:
        first = found["not_done"][0]
        lines.append(
            f"{found['runs'] - found['done']} runs could not be done, {first['runs']} of them because: "
            f"{first['why']}"
        )
    if found["stiffen"]:
        best = min(found["stiffen"], key=lambda row: row["error_left"])
        lines.append(
            f"{best['joint'].replace('-', ' ').capitalize()} is the one to stiffen: twice as stiff, the error at "
            f"{best['at'].replace('_', ' under ')} falls to {100 * best['error_left']:.0f} % on average; it is the "
            f"best choice in {100 * best['best_in']:.0f} % of the runs."
        )
    if indices := found["sensitivity"].get("indices"):
        most = max(indices, key=lambda row: row.get("total", row["first"]))
        share = most.get("total", most["first"])
        lines.append(
            f"{most['parameter']} matters most for {found['outcome']}: {100 * share:.0f} % of its variance."
        )
    known = [row for row in found["coverage"] if "within_2" in row]
    if known:
        mean = np.mean([row["within_2"] for row in known])
        lines.append(
            f"95 % intervals of {len(known)} parameters hold the true value in {100 * mean:.1f} % of the "
            "runs."
        )
    elif found["coverage"]:
        ratio = np.median([row["ratio"] for row in found["coverage"]])
        lines.append(
            f"Parameters of resampled recordings spread {ratio:.2f} times as much as their stated sigma "
            "(median)."
        )
    return lines
