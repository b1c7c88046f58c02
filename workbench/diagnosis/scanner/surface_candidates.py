"""Effects that points on a ball can show of a sensor with its own calibration, and smooth nonparametric alternatives.

An alternative displaces the points along one axis of the sensor by a polynomial of one covariate. Where one explains
more than every effect with a name, something is missing that no name describes.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.polynomial.legendre import legvander

from datasets.recording import Recording
from robot_model.effects.drift import BaseDrift
from robot_model.effects.elastic import ToolDeflection
from sensors.effects import artefact, recorded, surface
from workbench.diagnosis.scanner.surface_problem import SurfaceData

UNKNOWN = "unknown"
_STEEPEST = np.deg2rad(75.0)
"""Incidence from which on the shift along the ray, which grows with its tangent, grows no more."""
_DRIFT_DEGREES = (1, 3)
_DEGREES = (1, 2, 3, 5)
"""Of the polynomials of an alternative."""
_COSINES = (8, 12, 20, 32)
"""Terms of its cosine series, which do not grow where no point was: the finest half wave is 3 % of the field."""
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Candidate:
    """An effect by its word of the vocabulary at a place `where`, `label`, `names` and `units` of its parameters.

    `columns` (n, k): mm by which the distance of each point grows for one unit of each parameter. `depends_on`: the
    covariates; `covariate` (n,) values of the only one, if it is one.
    """

    effect: str
    where: str
    label: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    columns: np.ndarray
    depends_on: tuple[str, ...]
    covariate: np.ndarray | None = None

    @property
    def kind(self) -> tuple:
        """Kind regardless of the number of terms: functions of one covariate along one axis are one alternative."""
        return (self.effect, self.where, self.depends_on, self.label.split(",")[0])

    @property
    def is_named(self) -> bool:
        """False for a smooth nonparametric alternative."""
        return self.effect != UNKNOWN


def candidates(recording: Recording, data: SurfaceData, is_profile: bool) -> list[Candidate]:
    """All effects and alternatives; is_profile: points lie in the plane y = 0 of the sensor."""
    found = [*_of_range(data), *_field_biases(data, is_profile), *_of_poses(data)]
    covariates = _covariates(data, is_profile)
    if recording.measures == "ball-surface":
        incidence = np.arccos(_cosine(data, is_profile))
        covariates["incidence"] = np.rad2deg(incidence)
        found += [_of_incidence(incidence), *_of_ball(data)]
    recorded_columns = dict(_recorded(recording, data))
    for name, values in recorded_columns.items():
        column = (data.along(2) * _standardised(values))[:, None]
        label = f"z errs with {name}"
        about = (recorded.RecordedColumn.effect, "sensor", label, ("slope",), ("mm",))
        found.append(Candidate(*about, column, (name,), values))
    return found + list(_smooth(data, covariates | recorded_columns, is_profile))


def _of_range(data: SurfaceData) -> Iterator[Candidate]:
    z = data.local[2]
    depth = (data.along(2) * (z - np.median(z)))[:, None]
    about = (surface.RangeScale.effect, "sensor", "scale of z", ("scale",), ("mm/mm",))
    yield Candidate(*about, depth, ("z",), z)


def _of_incidence(incidence: np.ndarray) -> Candidate:
    """incidence (n,): rad."""
    label = "shift along the ray with incidence"
    about = (surface.IncidenceBias.effect, "sensor", label, ("shift",), ("mm",))
    column = -np.tan(incidence) * np.cos(incidence)
    return Candidate(*about, column[:, None], ("incidence",), np.rad2deg(incidence))


def _field_biases(data: SurfaceData, is_profile: bool) -> Iterator[Candidate]:
    """Polynomials of the second degree of one coordinate of the field, and of both."""
    x, y, _ = data.local
    size = max(np.abs(np.stack([x, y])).max(), 1e-9)
    flat = {"x": x / size} if is_profile else {"x": x / size, "y": y / size}
    for chosen in ["x"] if is_profile else ["x", "y", "xy"]:
        powers = {name: flat[name] for name in chosen}
        for first, second in combinations_with_replacement(chosen, 2):
            powers[first + second] = flat[first] * flat[second]
        label = f"z errs by a quadratic polynomial of {' and '.join(chosen)}"
        about = (surface.FieldBias.effect, "sensor", label, tuple(powers), ("mm",) * len(powers))
        columns = data.along(2)[:, None] * np.stack(list(powers.values()), axis=1)
        yield Candidate(*about, columns, tuple(chosen))


def _cosine(data: SurfaceData, is_profile: bool) -> np.ndarray:
    """(n,) cosine of the angle between ray and normal, of a surface that is not seen too steeply."""
    rays = np.stack([0 * data.local[0], 0 * data.local[1], 1 + 0 * data.local[2]])
    if not is_profile:
        rays = data.local / np.linalg.norm(data.local, axis=0)
    rays = np.einsum("nij,jn->ni", data.sensor[data.pose][:, :3, :3], rays)
    return np.clip(-np.einsum("ni,ni->n", data.normal, rays), np.cos(_STEEPEST), 1)


def _of_ball(data: SurfaceData) -> Iterator[Candidate]:
    about = (artefact.BallRadius.effect, "ball-1", "radius of the ball", ("radius",), ("mm",))
    yield Candidate(*about, np.ones((len(data.residual), 1)), ())
    for degree in (2, 3):
        lobes = artefact.spherical_harmonics(degree, data.normal.T).T
        names = tuple(f"d{degree}m{k}" for k in range(lobes.shape[1]))
        label = f"lobes of degree {degree}, in the axes of the base"
        about = (artefact.BallForm.effect, "ball-1", label, names, ("mm",) * len(names))
        yield Candidate(*about, lobes, ("normal",))


def _of_poses(data: SurfaceData) -> Iterator[Candidate]:
    """Motions of the whole sensor: under gravity, and with time."""
    in_flange = np.einsum("nji,nj->ni", data.flange[data.pose, :3, :3], data.normal)
    gravity = -data.flange[data.pose, 2, :3]  # of a base whose z is vertical
    about = (ToolDeflection.effect, "tool", "sag under its own weight")
    names = tuple(f"sag_{axis}" for axis in AXES)
    yield Candidate(*about, names, ("mm",) * 3, in_flange * gravity, ("attitude",))
    order = _unit(data.pose)
    for degree in _DRIFT_DEGREES:
        powers = legvander(order, degree)[:, 1:]
        columns = (data.normal[:, :, None] * powers[:, None]).reshape(len(order), -1)
        names = tuple(f"{axis}_{k + 1}" for axis in AXES for k in range(degree))
        label = f"base or ball move slowly from pose to pose, a polynomial of degree {degree}"
        about = (BaseDrift.effect, "base", label, names, ("mm",) * len(names))
        yield Candidate(*about, columns, ("order",), data.pose + 1.0)


def _recorded(recording: Recording, data: SurfaceData) -> Iterator[tuple[str, np.ndarray]]:
    """Recorded columns that vary, by name, of the points that are used."""
    for name, cells in recording.covariates.items():
        values = cells[data.row]
        if np.isfinite(values).all() and np.ptp(values) > 0:
            yield name, values


def _covariates(data: SurfaceData, is_profile: bool) -> dict[str, np.ndarray]:
    covariates = dict(zip(AXES, data.local)) | {"order": data.pose + 1.0}
    if is_profile:
        del covariates["y"]
    return covariates


def _smooth(data: SurfaceData, covariates, is_profile: bool) -> Iterator[Candidate]:
    for name, values in covariates.items():
        bases = list(_bases(values))
        for axis in AXES:
            if is_profile and axis == "y":
                continue
            along = data.along(AXES.index(axis))[:, None]
            for text, columns in bases:
                count = columns.shape[1]
                if count <= _named_degree(name, axis):
                    continue
                label = f"{axis} errs by a function of {name}, {text}"
                names = tuple(f"p{k + 1}" for k in range(count))
                about = (UNKNOWN, "sensor", label, names, ("mm",) * count)
                yield Candidate(*about, along * columns, (name,), values)


def _bases(values: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Columns (n, k) without a constant that the number of different values supports, with their description."""
    unit = _unit(values)
    most = len(np.unique(values)) // 2 - 1
    for degree in _DEGREES:
        if degree <= most:
            yield f"a polynomial of degree {degree}", legvander(unit, degree)[:, 1:]
    for terms in _COSINES:
        if terms <= most:
            phase = np.pi / 2 * (unit + 1)[:, None] * np.arange(1, terms + 1)
            yield f"a cosine series of {terms} terms", np.cos(phase)


def _named_degree(covariate: str, axis: str) -> int:
    """Degree up to which a polynomial is an effect with a name: a scale of z, a bias of the field."""
    if axis != "z":
        return 0
    return {"x": 2, "y": 2, "z": 1}.get(covariate, 0)


def _unit(values: np.ndarray) -> np.ndarray:
    """(n,) values scaled to -1 ... 1."""
    low, high = float(values.min()), float(values.max())
    return 2 * (values - low) / max(high - low, 1e-12) - 1


def _standardised(values: np.ndarray) -> np.ndarray:
    return (values - values.mean()) / values.std()
