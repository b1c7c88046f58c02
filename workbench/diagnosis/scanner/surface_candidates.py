"""Effects that points on a ball can show of a sensor with its own calibration, and smooth nonparametric alternatives.

The columns of an effect are those of its own definition (`Effect.basis`), as displacements along the ball's normal.
An alternative displaces the points along one axis of the sensor by a function of one covariate. If it explains more
than every effect of the catalogue, the discrepancy is unexplained.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from numpy.polynomial.legendre import legvander

from datasets.recording import Recording
from robot_model.effects.drift import BaseDrift
from robot_model.effects.elastic import ToolDeflection
from sensors.effects import artefact, recorded, surface
from workbench.core.effect import Effect
from workbench.diagnosis.scanner.surface_problem import SurfaceData

UNKNOWN = "unknown"
_DRIFT_DEGREES = (1, 3)
"""Of the polynomials of a drift: a constant rate, and a rate that varies."""
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
    state = _State.of(recording, data, is_profile)
    found = [*_of_sensor(data, state, is_profile), *_of_poses(data, state)]
    covariates = dict(zip(AXES, data.local)) | {"order": data.pose + 1.0}
    if is_profile:
        del covariates["y"]
    if recording.measures == "ball-surface":
        covariates["incidence"] = np.rad2deg(state.incidence)
        found += _of_ball(data, state)
    recorded_columns = dict(_recorded(recording, data))
    for name, values in recorded_columns.items():
        derivative = data.displacement_derivative(2)
        column = (derivative * (values - values.mean()))[:, None]
        description = (recorded.RecordedColumn.effect, "sensor", f"z errs with {name}")
        found.append(Candidate(*description, ("slope",), ("mm/unit",), column, (name,), values))
    return found + list(_smooth(data, covariates | recorded_columns, is_profile))


@dataclass(frozen=True)
class _State:
    """What the effects read of n points: `points`, unit `rays` and outward `normals` (3, n) in the sensor frame,
    `field` (2, n), `ball` (n,), `frames` with the axes of the flange, `gravity` (3,) in the base, `covariates`."""

    points: np.ndarray
    rays: np.ndarray
    normals: np.ndarray
    field: np.ndarray
    ball: np.ndarray
    frames: SimpleNamespace
    gravity: np.ndarray
    covariates: Mapping[str, np.ndarray]

    @classmethod
    def of(cls, recording: Recording, data: SurfaceData, is_profile: bool) -> "_State":
        """Of a base whose z is vertical; the clock is the recorded time, or the number of the pose."""
        local = data.local
        rays = local / np.linalg.norm(local, axis=0)
        if is_profile:  # the plane of light is all that is known of them
            rays = np.broadcast_to(np.array([[0.0], [0.0], [1.0]]), local.shape)
        normals = np.stack([data.displacement_derivative(axis) for axis in range(3)])
        axes = data.flange[data.pose, :3, :3].transpose(2, 1, 0)
        time = recording.covariates.get("time_s")
        if time is None:
            clock = data.pose.astype(float)
        else:
            clock = time[data.row]
        size = max(float(np.abs(local[:2]).max()), 1e-9)
        frames = SimpleNamespace(link=[axes])
        ball = np.ones(len(data.pose), int)
        gravity = np.array([0.0, 0.0, -1.0])
        field = local[:2] / size
        return cls(local, rays, normals, field, ball, frames, gravity, {"time_s": clock})

    @property
    def n(self) -> int:
        return self.points.shape[1]

    @property
    def incidence(self) -> np.ndarray:
        """(n,) rad."""
        cosine = np.abs((self.rays * self.normals).sum(0))
        return np.arccos(np.clip(cosine, 0, 1))


def _candidate(
    effect: Effect,
    label: str,
    state,
    normals: np.ndarray,
    depends_on: tuple[str, ...],
    chosen: slice | list[int] = slice(None),
) -> Candidate:
    """A candidate with the columns of an effect's definition; normals (3, n): in the frame of its displacement.

    chosen: which of its parameters.
    """
    basis = effect.basis(state)[chosen]
    components = effect.components or range(basis.shape[1])
    directions = np.stack([normals[k] for k in components])
    columns = np.einsum("pcn,cn->np", basis, directions)
    table = np.array(effect.table(None), object)[chosen]
    names = tuple(p.key.rpartition(".")[2] for p in table)
    units = tuple(p.unit for p in table)
    return Candidate(effect.effect, effect.where, label, names, units, columns, depends_on)


def _of_sensor(data: SurfaceData, state: _State, is_profile: bool) -> Iterator[Candidate]:
    """Displacements of the measured points in the sensor frame."""
    scale = surface.RangeScale("sensor", z0=float(np.median(data.local[2])))
    yield _candidate(scale, "scale of z", state, state.normals, ("z",))
    for axis in "x" if is_profile else "xy":
        lateral = surface.LateralScale("sensor", axis)
        yield _candidate(lateral, f"scale of {axis}", state, state.normals, (axis,))
    bias = surface.FieldBias("sensor")
    if is_profile:
        fields = {"x": [0, 2]}
    else:
        fields = {"x": [0, 2], "y": [1, 4], "x and y": slice(None)}
    for name, chosen in fields.items():
        label = f"z errs by a quadratic polynomial of {name}"
        depends_on = tuple(name.split(" and "))
        yield _candidate(bias, label, state, state.normals, depends_on, chosen)
    yield from _of_axes(data, is_profile)


def _of_axes(data: SurfaceData, is_profile: bool) -> Iterator[Candidate]:
    """Axes that are not orthogonal: the linear part of a bias over the field."""
    pairs = ("xz",) if is_profile else ("xy", "xz", "yz")
    for first, second in pairs:
        label = f"angle between {first} and {second} is not 90 deg"
        yield _linear(data, first, second, label, "angle", "rad")


def _linear(data: SurfaceData, axis: str, covariate: str, *description: str) -> Candidate:
    """One axis errs in proportion to a coordinate; description: label, name and unit of the parameter."""
    values = data.local[AXES.index(covariate)]
    deviation = values - np.median(values)
    derivative = data.displacement_derivative(AXES.index(axis))
    column = derivative * deviation
    label, name, unit = description
    kind = (surface.FieldBias.effect, "sensor", label)
    return Candidate(*kind, (name,), (unit,), column[:, None], (covariate,), values)


def _of_ball(data: SurfaceData, state: _State) -> Iterator[Candidate]:
    """Errors of incidence, and of the ball itself."""
    shift = surface.IncidenceBias("sensor")
    label = "shift along the ray with incidence"
    yield _candidate(shift, label, state, state.normals, ("incidence",))
    radius = artefact.BallRadius("ball-1")
    yield _candidate(radius, "radius of the ball", state, state.normals, ())
    in_base = SimpleNamespace(normals=data.normal.T, ball=state.ball)
    for degree in (2, 3):
        form = artefact.BallForm("ball-1", degree)
        label = f"lobes of degree {degree}, in the axes of the base"
        yield _candidate(form, label, in_base, data.normal.T, ("normal",))


def _of_poses(data: SurfaceData, state: _State) -> Iterator[Candidate]:
    """Motions of the whole sensor, under gravity and with time: a point is computed where it would be without them."""
    rotation = data.flange[data.pose, :3, :3]
    in_flange = np.einsum("nji,nj->in", rotation, data.normal)
    deflection = ToolDeflection("tool")
    yield _candidate(deflection, "sag under its own weight", state, -in_flange, ("attitude",))
    time = state.covariates["time_s"]
    if not np.ptp(time) > 0:
        return
    for order in _DRIFT_DEGREES:
        drift = BaseDrift("base", float(time.min()), float(time.max()), order)
        # a rotation of the base moves one ball as a translation does
        shifts = [6 * degree + axis for degree in range(order) for axis in range(3)]
        label = f"base or ball move slowly from pose to pose, a polynomial of degree {order}"
        normals = np.concatenate([-data.normal.T, np.zeros_like(data.normal.T)])
        yield _candidate(drift, label, state, normals, ("order",), shifts)


def _recorded(recording: Recording, data: SurfaceData) -> Iterator[tuple[str, np.ndarray]]:
    """Recorded columns that vary, by name, of the points that are used."""
    for name, cells in recording.covariates.items():
        values = cells[data.row]
        if np.isfinite(values).all() and np.ptp(values) > 0:
            yield name, values


def _smooth(data: SurfaceData, covariates, is_profile: bool) -> Iterator[Candidate]:
    for name, values in covariates.items():
        bases = list(_bases(values))
        for axis in AXES:
            if is_profile and axis == "y":
                continue
            derivative = data.displacement_derivative(AXES.index(axis))[:, None]
            for text, columns in bases:
                count = columns.shape[1]
                if count <= _named_degree(name, axis):
                    continue
                label = f"{axis} errs by a function of {name}, {text}"
                names = tuple(f"p{k + 1}" for k in range(count))
                description = (UNKNOWN, "sensor", label, names, ("mm",) * count)
                yield Candidate(*description, derivative * columns, (name,), values)


def _bases(values: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Columns (n, k) without a constant that the number of different values supports, with their description."""
    unit = _unit(values)
    max_degree = len(np.unique(values)) // 2 - 1
    for degree in _DEGREES:
        if degree <= max_degree:
            yield f"a polynomial of degree {degree}", legvander(unit, degree)[:, 1:]
    for terms in _COSINES:
        if terms <= max_degree:
            half_turns = np.pi / 2 * (unit + 1)[:, None]
            phase = half_turns * np.arange(1, terms + 1)
            yield f"a cosine series of {terms} terms", np.cos(phase)


def _named_degree(covariate: str, axis: str) -> int:
    """Degree up to which a polynomial is an effect with a name: a scale, an angle of axes, a bias of the field."""
    if axis != "z":
        return 1 if covariate in AXES else 0
    return {"x": 2, "y": 2, "z": 1}.get(covariate, 0)


def _unit(values: np.ndarray) -> np.ndarray:
    """(n,) values scaled to -1 ... 1."""
    low = float(values.min())
    high = float(values.max())
    return 2 * (values - low) / max(high - low, 1e-12) - 1
