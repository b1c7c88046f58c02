"""Removes fitted terms from real recordings and plants effects into them; real noise and structure remain."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from robot_model.effects.transmission import TransmissionHarmonic, turning_joints
from workbench.core.effect import NUMBERED, Effect
from workbench.core.least_squares.linear_algebra import thin_svd
from workbench.core.vocabulary import Covariate, Place
from workbench.diagnosis.robot.library import compliances, names
from workbench.proving.oracle import Bench

_SUPPORT = 0.9
"""A term is supported if it lowers the held-out RMS significantly and at least to this share."""
_MOST_TERMS = 3
_SMALL = 1e-4
_CYCLES = 2.0  # order of the fitted transmission-error harmonic, cycles per revolution
_kept: dict[str, tuple] = {}
_LOADED_NM, _TURNS_RAD = 0.5, 1.0


@dataclass(frozen=True)
class Term:
    """An effect that data support: name, place, options as pairs.

    `confounded`: (effect, place) of compliances that predict the held-out samples equally well.
    """

    effect: str
    where: str
    options: tuple = ()
    confounded: tuple[tuple[str, str], ...] = ()

    @property
    def row(self) -> tuple:
        """The row of the catalogue."""
        return self.effect, self.where, dict(self.options)


def supported(recording, name: str) -> tuple[Term, ...]:
    """Supported terms, strongest first: each lowers the held-out error conditional on the terms before it."""
    if name not in _kept:
        bench = Bench(recording, "geometry")
        candidates = _possible(bench)
        terms = []
        best = bench.predicted(())
        while candidates and len(terms) < _MOST_TERMS:
            tried = [
                bench.predicted([t.row for t in (*terms, candidate)]) for candidate in candidates
            ]
            k = int(np.argmin([prediction.rms for prediction in tried]))
            if tried[k].rms > _SUPPORT * best.rms or not tried[k].beats(best):
                break
            best = tried[k]
            terms.append(replace(candidates[k], confounded=_confounded(candidates, tried, k)))
            candidates.pop(k)
        _kept[name] = tuple(terms)
    return _kept[name]


def _confounded(terms, tried, k: int) -> tuple[tuple[str, str], ...]:
    """Compliances that predict the held-out samples as well as the compliance k."""
    compliant = names(_compliances())
    if terms[k].effect not in compliant:
        return ()
    return tuple(
        (term.effect, term.where)
        for term, predicted in zip(terms, tried)
        if term is not terms[k] and term.effect in compliant and not tried[k].beats(predicted)
    )


def _compliances() -> list[type[Effect]]:
    """Effects of joints and links that deflect under gravity."""
    from robot_model.effects import CATALOGUE

    return [kind for kind in compliances(CATALOGUE) if kind.places[0] in NUMBERED]


def _possible(bench: Bench) -> list[Term]:
    """Candidates: all loaded compliances, and transmission harmonics of order 2 of joints with a large range."""
    chain, terms = bench.chain, []
    for kind in _compliances():
        for effect in map(kind, chain.places(kind.places[0])):
            if np.ptp(effect.load(chain.state), axis=1).max() > _LOADED_NM:
                terms.append(Term(effect.effect, effect.where))
    order = (("order", _CYCLES),)
    turning = turning_joints(chain, _TURNS_RAD)
    return terms + [Term(TransmissionHarmonic.effect, where, order) for where in turning]


def without_contribution(recording, name: str, terms):
    """The recording without the contribution of `terms` to its points; all supported terms are fitted jointly."""
    model, fitted = _fitted(name, recording)
    bare = fitted
    for term in terms:
        bare = bare.update(
            {key: 0.0 for key in fitted.keys if key.startswith(f"{term.where}.{term.effect}.")}
        )
    change = model.residual(fitted)[:3] - model.residual(bare)[:3]
    return _moved(recording, -change)


def _fitted(name: str, recording):
    from workbench.core.least_squares.solver import solve

    rows = [term.row for term in supported(recording, name)]
    model, start = Bench(recording, "geometry").model(rows)
    return model, solve(model, start, "huber").parameters


def _moved(recording, change):
    """The recording with its points (n, 3) moved by `change` (3, n) mm."""
    columns = dict(recording.columns)
    for axis, row in zip("xyz", change):
        columns[f"{axis}_mm"] = columns[f"{axis}_mm"] + row
    return replace(recording, columns=columns)


def jittered(recording, rng):
    """A copy with uniform noise in the last digit only: readings ±5e-5 deg, points ±5e-5 mm."""
    columns = dict(recording.columns)
    for name in columns:
        if name in ("x_mm", "y_mm", "z_mm") or Covariate.of(name).is_angle:
            columns[name] = columns[name] + rng.uniform(-5e-5, 5e-5, recording.n)
    return replace(recording, columns=columns)


def plant(recording, rng: np.random.Generator, times: float):
    """The recording with an effect planted into its joint readings, and its truth.

    times: RMS per coordinate of the effect after a fit of the geometry, over that of the real residual.
    """
    geometry = _fitted_geometry(recording)
    for _ in range(50):
        effect, wave, unit = _drawn(recording, rng)
        if np.ptp(wave) == 0:
            continue
        change, real = _orthogonal_size(geometry, effect, wave)
        if change < 1e-3 * _SMALL:
            continue
        size = times * real / change * _SMALL * float(rng.choice([-1, 1]))
        if abs(size) * np.abs(wave).max() < 0.02:  # rad: upper limit of plausible drive errors
            truth = {**effect, "value": size, "unit": unit, "survives_sigma": None, "times": times}
            return _read_off(recording, effect, size * wave), truth
    raise ValueError("no effect of a size that a drive could have can be planted here")


@dataclass(frozen=True)
class Readings:
    """Data of a recording that a planted effect depends on: `angles` (J, n) rad, `poses` (n,), `columns`."""

    angles: np.ndarray
    poses: np.ndarray
    columns: Mapping[str, np.ndarray]


def _drawn(recording, rng) -> tuple[dict, np.ndarray, str]:
    """Effect, its change of the joint angle (n,) for unit size, and the unit of its size."""
    from robot_model.effects import CATALOGUE

    joint = int(rng.integers(recording.joints.shape[1])) + 1
    kinds = [kind for kind in CATALOGUE.values() if kind.plant_weight]
    weights = np.array([kind.plant_weight for kind in kinds])
    kind = kinds[int(rng.choice(len(kinds), p=weights / weights.sum()))]
    readings = Readings(_angles(recording), recording.poses, recording.columns)
    detail, wave = kind.planted(readings, joint, rng)
    return {"effect": kind.effect, "where": f"joint-{joint}", "detail": detail}, wave, "rad"


def _angles(recording) -> np.ndarray:
    """(J, n) rad: joint angles with sign and coupling applied."""
    return _mixing(recording) @ recording.joints.T


def _mixing(recording) -> np.ndarray:
    from robot_model import load_robot

    return load_robot(recording.robot, "robot").mixing


def _read_off(recording, effect: Mapping, wave):
    """The recording with the readings that a controller shows if the effect causes part of the true joint angle."""
    joint = Place.of(effect["where"]).number - 1
    error = np.zeros((recording.joints.shape[1], recording.n))
    error[joint] = wave
    moved = np.rad2deg(np.linalg.pinv(_mixing(recording)) @ error)
    columns = dict(recording.columns)
    for k, row in enumerate(moved, 1):
        columns[f"q{k}_deg"] = columns[f"q{k}_deg"] - row
    return replace(recording, columns=columns)


@dataclass(frozen=True)
class Geometry:
    """The fitted geometry of a recording: orthonormal `basis` (N, R) of its Jacobian, `residual` (m, n) mm."""

    model: object
    values: np.ndarray
    residual: np.ndarray
    basis: np.ndarray


def _orthogonal_size(geometry: Geometry, effect, wave) -> tuple[float, float]:
    """RMS per coordinate, mm, after a fit of the geometry: of a small effect, and of the real residual."""
    basis, chain = geometry.basis, geometry.model.chain
    joint = Place.of(effect["where"]).number - 1
    chain_values = geometry.values[: len(chain.parameters)]
    rows = chain.evaluate(chain_values, {}).rows("joint", np.array([joint]))[0]
    change = (rows * (_SMALL * wave)).ravel()
    change = change - basis @ (basis.T @ change)
    return float(np.sqrt(np.mean(change**2))), float(np.sqrt(np.mean(geometry.residual**2)))


def _fitted_geometry(recording) -> Geometry:
    """Geometry, base and tool fitted to a recording."""
    from workbench.core.least_squares.solver import solve

    model, start = Bench(recording, "geometry").model(())
    fitted = solve(model, start, "huber").parameters
    residual, rows = model.linearise(fitted)
    flat = rows.reshape(len(rows), -1).T
    size = np.linalg.norm(flat, axis=0)
    matrix = flat[:, size > 0] / size[size > 0]
    u, s, _ = thin_svd(matrix)
    return Geometry(model, fitted.values, residual, u[:, s > 1e-8 * s[0]])
