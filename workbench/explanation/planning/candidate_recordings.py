"""Recordings that could be made next with the same arm: more poses, or the same with something else changed."""

from dataclasses import dataclass, field, replace

import numpy as np

from robot_model.measurements.ball_scan import KIND
from robot_model.state import State
from robot_model.system import bind
from workbench.core.covariates import MotionHistory, clock
from workbench.core.model import Model
from workbench.core.vocabulary import Covariate
from workbench.diagnosis.robot.bench import with_derived

POOL = 120
_BALLS = ("ball-centre", KIND)
"""Kinds of a sensor on the flange that must see its ball."""
_LOAD_SHARE = 0.1
_LEAST_LOAD_KG = 2.0
_WARMER_K = 10.0
_MOVED_RAD = 0.2
MORE_POSES, LOAD, WARM, SIDES = (
    "more poses",
    "the same poses with more load",
    "the same poses warmer",
    "both sides",
)


@dataclass(frozen=True)
class CandidateRecording:
    """A kind of recording: what was measured with `extra` rows after it.

    `pose` (extra,) 0, 1, ... which of the pool's poses each extra row is of; `sides` (extra,) +-1 the side of approach,
    0 where not planned. `words`: the sentence, with {poses}. `samples`: numbers of the rows that are measured again.
    """

    name: str
    words: str
    recording: object
    pose: np.ndarray
    sides: np.ndarray
    samples: np.ndarray | None
    scene: dict = field(default_factory=dict)

    def state(self, chain) -> State:
        """The state of all rows, the planned side of approach and last move written over those of the extra ones."""
        state = with_derived(chain, np.arange(chain.n))
        if not self.sides.any():
            return state
        covariates = dict(state.covariates)
        extra = np.arange(chain.n) >= chain.n - len(self.pose)
        for name in list(covariates):
            known = Covariate.of(name)
            if known.kind not in ("approach", "move"):
                continue
            is_angle = known.kind == "move" and not known.unit  # and no state from -1 to 1
            size = _MOVED_RAD if is_angle else 1.0
            covariates[name] = covariates[name].copy()
            covariates[name][extra] = size * self.sides
        moves = np.stack([covariates[f"move{k}"] for k in range(1, chain.robot.joints + 1)])
        return replace(state, covariates=covariates, history=MotionHistory.of(moves, clock(state)))

    def listing(self, chosen: np.ndarray) -> np.ndarray:
        """Joint readings (k, J), in the recording's own units, of the chosen poses of the pool."""
        first = self.recording.n - len(self.pose)
        rows = [first + int(np.flatnonzero(self.pose == k)[0]) for k in chosen]
        columns = [c for c in self.recording.columns if Covariate.of(c).is_reading]
        return np.stack([self.recording.columns[c][rows] for c in columns], 1)


def list_candidates(bench) -> list[CandidateRecording]:
    """Every kind that makes sense for this arm and recording."""
    rng = np.random.default_rng(0)
    recording = bench.recording
    poses = np.unique(bench.pose)
    pool = rng.choice(poses, min(POOL, len(poses)), replace=False)
    rows = np.concatenate([np.flatnonzero(bench.pose == p) for p in pool])
    pose = np.concatenate([np.full((bench.pose == p).sum(), k) for k, p in enumerate(pool)])
    rows, pose = _first_repeats(recording, rows, pose)
    candidates = [_more_poses(bench, rows, pose, rng)]
    if bench.chain.robot.mass.any():
        candidates.append(_loaded(bench, rows, pose))
    if "temperature_c" in recording.columns:
        candidates.append(_warmer(recording, rows, pose))
    if bench.chain.variables.shape[0]:
        candidates.append(_both_sides(recording, rows, pose))
    return candidates


def _first_repeats(recording, rows, pose):
    """Of repeats only the first: one row a pose and target."""
    target = recording.ball if recording.measures in _BALLS else recording.reflector
    _, first = np.unique(np.stack([pose, target[rows]]), axis=1, return_index=True)
    first = np.sort(first)
    return rows[first], pose[first]


def _joined(recording, rows, changed=None):
    """The recording with some of its rows once more at its end, their columns changed."""
    extra = {name: column[rows] for name, column in recording.columns.items()}
    extra |= changed or {}
    last = float(np.max(recording.columns.get("sample", np.arange(recording.n))))
    extra["sample"] = last + 1 + np.arange(len(rows))
    if "row" in recording.columns:
        extra["row"] = float(recording.columns["row"].max()) + 1 + np.arange(len(rows))
    names = set(recording.columns) | set(extra)
    blank = {name: recording.columns.get(name, np.zeros(recording.n)) for name in names}
    return replace(
        recording,
        columns={name: np.concatenate([blank[name], extra[name]]) for name in sorted(names)},
    )


def _loaded(bench, rows, pose) -> CandidateRecording:
    robot = bench.chain.robot
    recorded_loads = bench.recording.columns.get("payload_kg", np.zeros(bench.recording.n))
    load = max(_LEAST_LOAD_KG, round(2 * _LOAD_SHARE * float(robot.mass.sum())) / 2)
    joined = _joined(bench.recording, rows, {"payload_kg": recorded_loads[rows] + load})
    words = f"measure {{poses}} of these poses again with {load:g} kg more on the flange"
    ids = bench.recording.sample_ids[rows]
    scene = {"payload_kg": [float(recorded_loads.min()), float(recorded_loads.max()) + load]}
    return CandidateRecording(LOAD, words, joined, pose, np.zeros(len(rows)), ids, scene)


def _warmer(recording, rows, pose) -> CandidateRecording:
    temperature = recording.columns["temperature_c"]
    joined = _joined(recording, rows, {"temperature_c": temperature[rows] + _WARMER_K})
    words = f"measure {{poses}} of these poses again {_WARMER_K:g} K warmer"
    scene = {"temperature_c": [float(temperature.min()), float(temperature.max()) + _WARMER_K]}
    return CandidateRecording(
        WARM, words, joined, pose, np.zeros(len(rows)), recording.sample_ids[rows], scene
    )


def _both_sides(recording, rows, pose) -> CandidateRecording:
    doubled = np.concatenate([rows, rows])
    sides = np.repeat([-1.0, 1.0], len(rows))
    order = np.argsort(np.concatenate([pose, pose]), kind="stable")
    changed = {name: sides[order] for name in recording.columns if Covariate.of(name).is_signed}
    words = "come to {poses} of these poses from both sides of every joint"
    return CandidateRecording(
        SIDES,
        words,
        _joined(recording, doubled[order], changed),
        np.sort(np.concatenate([pose, pose])),
        sides[order],
        recording.sample_ids[doubled[order]],
        {"approach": True},
    )


def _more_poses(bench, rows, pose, rng) -> CandidateRecording:
    """New poses: at random among those measured for a sensor that must see its ball, else in the joints' ranges."""
    recording = bench.recording
    names = [c for c in recording.columns if Covariate.of(c).is_reading]
    readings = np.stack([recording.columns[c] for c in names])
    low = readings.min(1)
    high = readings.max(1)
    count = pose.max() + 1
    if recording.measures in _BALLS:
        fresh = (
            readings[:, rows]
            + 0.03 * (high - low)[:, None] * rng.normal(size=(count, len(names))).T[:, pose]
        )
    else:
        fresh = rng.uniform(low, high, (count, len(names))).T[:, pose]
    changed = dict(zip(names, np.clip(fresh, low[:, None], high[:, None])))
    joined = _seen(bench, _joined(recording, rows, changed))
    return CandidateRecording(
        MORE_POSES,
        "measure {poses} more poses that are selected for it",
        joined,
        pose,
        np.zeros(len(rows)),
        None,
    )


def _seen(bench, joined):
    """The recording with the points that the fitted baseline predicts: what an effect reads of them."""
    model, fit, _ = bench.solve(())
    chain = bind(model.chain.robot, joined, model.chain.start)
    state = with_derived(chain, np.arange(chain.n))
    chain = replace(chain, state=state)
    joined_model = Model(chain, bench.baseline)
    residual = joined_model.residual(joined_model.parameters.take_over(fit.parameters))
    columns = dict(joined.columns) | chain.measurement.columns(residual)
    return replace(joined, columns=columns)
