"""The robot's entries of the catalogue page: simulated arms under a tracker, and with a scanner."""

import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import tomli_w

from catalogue_entries import FAINT, Entry, confounded, large_enough, listed, sizes
from robot_model.effects import CATALOGUE
from workbench.core.effect import make_effects
from workbench.core.model import NOISE
from workbench.diagnosis.robot.bench import bench_of
from workbench.explanation.planning.candidate_recordings import list_candidates
from workbench.explanation.planning.experiment import ConfoundedPair, compared, describe_comparison
from workbench.explanation.sentences.words import measured
from workbench.jobs.robot.simulate import simulate

_CAUSES = {
    "payload_kg": [0.0, 2.0],
    "approach": True,
    "speeds_deg_s": 20.0,
    "temperature_c": [20.0, 32.0],
}
TRACKER = {
    "robot": "abb_irb120",
    "measures": "external-point",
    "samples": 240,
    "seed": 1,
    "sigma_mm": 0.02,
    "reflectors": [[0.0, 30.0, 120.0]],
    "share_of_limits": 0.5,
    "base": {"xyz_mm": [1500.0, 200.0, -400.0]},
    "errors": {"length_mm": 0.2, "angle_deg": 0.05},
    **_CAUSES,
}
SCANNER = {
    "robot": "abb_irb120",
    "measures": "ball-centre",
    "samples": 240,
    "seed": 1,
    "sigma_mm": 0.02,
    "balls": [
        [0.0, 0.0, 0.0, 15.0],
        [80.0, 5.0, -3.0, 15.0],
        [10.0, 70.0, 4.0, 15.0],
        [90.0, 80.0, 40.0, 15.0],
    ],
    "base": {"xyz_mm": [-450.0, 0.0, -100.0]},
    "tool": {"xyz_mm": [0.0, 0.0, 60.0]},
    "errors": {"length_mm": 0.2, "angle_deg": 0.02},
    **_CAUSES,
}
_ELASTIC = [
    {"effect": "joint-compliance", "where": f"joint-{k}", "values": {"compliance": 3e-4}}
    for k in (2, 3)
]
_SPAN = {"start": 0.0, "end": 2390.0}
# where each effect sits on the page, its options, and what else the scene holds
_AT = {
    "joint": "joint-2",
    "link": "link-2",
    "base": "base",
    "tool": "tool",
    "sensor": "sensor",
    "ball": "ball-2",
    "artefact": "artefact",
    "time": "time",
    "noise": "noise",
    "instrument": "instrument",
}
_OPTIONS = {
    "joint-curve": {"start": -2.0, "end": 2.0, "terms": 7},
    "joint-torque": {"start": -2.0, "end": 2.0},
    "shift": {"after": 1200.0},
    "warm-up": {"time_constant": 600.0},
    "link-warm-up": {"time_constant": 600.0},
    "base-warm-up": {"time_constant": 600.0},
    "load-deflection": {"after": 1200.0},
    "loosening": _SPAN,
    "zero-shift": {"after": 1200.0},
    "joint-coupling": {"joint": 3},
    "base-drift": _SPAN,
    "range-scale": {"z0": 125.0},
    "noise-heteroscedastic": {"covariate": "temperature_c", "mean": 26.0, "spread": 4.0},
}
_PLACES = {
    "joint-coupling": "joint-4",
    "axis-run-out": "joint-3",
    "link-compliance": "link-2",
    "bearing-compliance": "joint-1",
    "joint-thermal-drift": "joint-3",
}
NOT_SEEN = {
    "gravity-compliance": "joint-compliance of an arm whose robot file states no masses: the same residual",
    "gravity-bearing-compliance": "bearing-compliance of an arm without stated masses: the same residual",
    "gravity-link-compliance": "link-compliance of an arm without stated masses: the same residual",
    "gravity-pedestal-compliance": "pedestal-compliance of an arm without stated masses: the same residual",
    "cyclic-lead-error": "it sits at prismatic joints, which this arm does not have",
    "payload-centre": "it needs a load that deflects the arm; see payload",
    "reading-lattice": "rounded readings, recognised from the readings themselves; they move no mean",
    "azimuth-harmonic": "an error curve of the instrument's azimuth encoder, shown by sight lines of many directions",
    "elevation-harmonic": "the same of its elevation encoder",
    "angular-noise": "noise that grows with the distance; see noise-heteroscedastic",
    "smooth-function": "a term without a physical law, which a diagnosis adds with its own covariates",
    "periodic-motion": "a term without a physical law, whose rate a diagnosis searches for",
    "compliance-with-masses": "an elastic law with combinations of masses that a diagnosis makes for its poses",
    "sensor-thermal-growth": "it is a range-scale that grows with the temperature",
    "lateral-scale": "it is the scale of a profiler's x, which points on balls show and centres of balls do not",
    "target-shift": "shift of one of several balls or reflectors instead of the whole tool or base",
    "zero-offset": "a zero offset under another name, which the baseline holds",
    "measured-tilt": "it needs the columns of an accelerometer, which a scene does not hold",
    "mount-tilt-torsion": "mount-tilt as an upright first joint shows it, which nothing else loads",
    "ye-compliance": "a variant of joint-compliance with Ye's own load",
}


def entries() -> Iterator[Entry]:
    """One a robot's effect that a fit of the geometry can miss."""
    for name, kind in CATALOGUE.items():
        if name not in NOT_SEEN:
            yield _entry(name, kind)


def _entry(name, kind) -> Entry:
    place = kind.places[0]
    where = _PLACES.get(name, _AT[place])
    scene = dict(SCANNER if kind.port in ("sensor", "target") else TRACKER)
    carried = kind.port in ("gravity", "mass")
    if carried:
        scene["effect"] = _ELASTIC
    if kind.port == NOISE:
        return _spread(name, kind, where, scene)
    baseline = "joint-compliance" if carried else "geometry"
    (effect,) = make_effects(CATALOGUE, [(name, where, _OPTIONS.get(name, {}))])
    perfect = _bench(scene, baseline)
    table = effect.parameters(perfect.chain)
    start = perfect.problem((effect,))
    values = large_enough(start, np.array([p.typical for p in table]))
    bench = _bench(
        _with(scene, name, effect, dict(zip((p.key for p in table), values.tolist()))), baseline
    )
    whole, left, orthogonal_share = sizes(start, values)
    near = confounded(start, values, f"{kind.effect} {where}")
    numbers = tuple(f"{p.label} {measured(v, None, p.unit)}" for p, v in zip(table, values))
    return Entry(
        name,
        kind,
        where,
        numbers,
        whole,
        left,
        orthogonal_share,
        "mm",
        listed(near),
        _separates(perfect, effect, start, values, near),
        bench.problem(),
        _flange(bench),
    )


def _flange(bench) -> np.ndarray:
    """(3, n) mm, root frame."""
    return bench.chain.state.frames.end_origin


def _spread(name, kind, where, scene) -> Entry:
    """The noise's: nothing but the scatter changes, so that no mean can be taken for it."""
    (effect,) = make_effects(CATALOGUE, [(name, where, _OPTIONS[name])])
    bench = _bench(
        _with(scene, name, effect, {"noise.noise-heteroscedastic.temperature_c": 0.6}), "geometry"
    )
    problem = bench.problem()
    size = float(np.sqrt(((problem.residual * problem.sigma) ** 2).sum() / problem.n))
    return Entry(
        name,
        kind,
        where,
        ("0.6 of log sigma a spread",),
        size,
        size,
        1.0,
        "mm",
        (),
        "Nothing else: the effect changes the variance and not the mean.",
        problem,
        _flange(bench),
    )


def _with(scene, name, effect, values) -> dict:
    options = {key: value for key, value in effect.options.items() if value is not None}
    cause = {"effect": name, "where": effect.where, **options, "values": values}
    return scene | {"effect": [*scene.get("effect", []), cause]}


def _bench(scene: dict, baseline: str):
    return _simulated(tomli_w.dumps(scene), baseline)


@cache
def _simulated(text: str, baseline: str):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(text, encoding="utf-8")
        return bench_of(simulate(path), baseline)


def _separates(bench, effect, problem, values, near) -> str:
    """The experiment that separates the effect from its most confounded one, by the diagnosis."""
    if not near or near[0][1] < 0.5:
        return "Nothing is needed: no other effect explains half of its residual."
    other, _ = near[0]
    left = np.sqrt((problem.orthogonalise(problem.added[0] @ values) ** 2).sum())
    known = ConfoundedPair(
        (effect,), values * FAINT / left, other.effects, "it", f"{other.effect} at {other.where}"
    )
    rows = compared(bench, (), known, list_candidates(bench))
    return (
        describe_comparison(known, rows)
        if rows
        else "No recording of the kinds that were compared."
    )
