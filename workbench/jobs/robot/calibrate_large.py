"""Calibration of a recording that is too long for memory: normal equations added up over chunks of its samples.

`calibrate` selects the stages by cross-validation on some thousand samples spread over the recording. Their free
parameters are then estimated on all samples, and held-out errors are of all samples too.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from datasets.samples.chunks import Chunks, read_chunks
from robot_model.system import bind, redundant_geometry
from workbench.core.effect import Effect
from workbench.core.errors import InputError
from workbench.core.least_squares.adjustment_tests import robust_sigma, variance_test
from workbench.core.least_squares.identifiability import identifiability, independent
from workbench.core.least_squares.linear_algebra import solve_positive
from workbench.core.least_squares.solver import CONVERGED, Equations, Fit, solve
from workbench.core.model import NOISE, Model
from workbench.core.parameters import Parameters
from workbench.core.solution import Solution
from workbench.files.results import parameter_rows
from workbench.files.solution_file import NAME, solution_keys
from workbench.fitting.calibration_plans.plans import frames_of
from workbench.fitting.cross_validation import error_summary
from workbench.fitting.verdicts.noise_report import NoiseReport, report
from workbench.jobs.robot.calibrate import Calibration, Stage, calibrate
from workbench.machine.progress import paced

_FLOOR = 1e-4


@dataclass(frozen=True)
class Stream:
    """All samples of a recording under one model, made chunk by chunk: what `solve` wants of a model.

    `extra` (m,) variance (mm^2, rad^2) added to each component's stated one, for what the model does not explain;
    `tick` is called with samples done and in all.
    """

    chunks: Chunks
    robot: object
    start: np.ndarray
    effects: tuple[Effect, ...]
    extra: np.ndarray
    tick: Callable[[int, int], None] = lambda done, total: None

    @cached_property
    def parameters(self) -> Parameters:
        return self._small.parameters

    @cached_property
    def spans(self) -> tuple[slice, ...]:
        return self._small.spans

    @property
    def chain(self):
        """Of one sample of every target: the same parameters, places and components as that of all samples."""
        return self._small.chain

    @cached_property
    def _small(self) -> Model:
        return Model(bind(self.robot, self.chunks.first_rows, self.start), self.effects)

    def models(self) -> Iterator[tuple[slice, Model]]:
        """Which samples, and the model of them; the rows of every target stand before each chunk while it is bound, so
        that all chunks number their targets alike."""
        first, known = 0, self.chunks.first_rows
        for part in self.chunks:
            names = part.columns
            joined_columns = {
                name: np.concatenate([known.columns[name], part.columns[name]]) for name in names
            }
            chain = bind(self.robot, replace(part, columns=joined_columns), self.start)
            chain = chain.at(np.arange(known.n, known.n + part.n))
            columns = slice(first, first + part.n)
            yield columns, Model(replace(chain, sigma=self._widened(chain)), self.effects)
            first = columns.stop
            self.tick(first, self.chunks.n)

    def _widened(self, chain):
        stated = 0 * chain.stated_sigma if chain.sigma_unknown else chain.stated_sigma
        wide = np.sqrt(stated**2 + self.extra[: len(stated), None])
        return np.where(wide > 0, wide, chain.sigma)

    def sigma(self, parameters: Parameters) -> np.ndarray:
        """(m, n) 1 sigma of every component of every sample."""
        return self._sigma

    @cached_property
    def _sigma(self) -> np.ndarray:
        return np.concatenate([model.chain.sigma for _, model in self.models()], 1)

    @property
    def stated_sigma(self) -> np.ndarray | None:
        """(m, n) 1 sigma as the recording states it; None where it does not."""
        if self.chain.sigma_unknown:
            return None
        return np.concatenate([model.chain.stated_sigma for _, model in self.models()], 1)

    def residual(self, parameters: Parameters) -> np.ndarray:
        """(m, n) predicted minus measured."""
        return np.concatenate([model.residual(parameters) for _, model in self.models()], 1)

    def linearise(self, parameters: Parameters) -> tuple[np.ndarray, Equations]:
        """Residual (m, n), and the normal equations added up over the chunks."""
        residual, (normal, gradient) = self.by_fold(parameters, np.zeros(self.chunks.n, int), 1)
        return residual, Equations(normal[0], gradient[0])

    def residual_and_derivative(
        self, parameters: Parameters
    ) -> tuple[np.ndarray, Callable[[], Equations]]:
        """As `linearise`, with the normal equations as a function: one pass over the chunks gives both."""
        residual, equations = self.linearise(parameters)
        return residual, lambda: equations

    def by_fold(self, parameters: Parameters, fold: np.ndarray, folds: int):
        """Residual (m, n), and (folds, F, F), (folds, F) normal matrices and gradients of the samples of each fold."""
        size = int(parameters.mask.sum())
        normal = np.zeros((folds, size, size))
        gradient = np.zeros((folds, size))
        residuals = []
        for columns, model in self.models():
            residual, rows = model.linearise(parameters)
            rows /= model.chain.sigma
            white = residual / model.chain.sigma
            for k in range(folds):
                if folds == 1:
                    fold_samples = slice(None)
                else:
                    fold_samples = np.flatnonzero(fold[columns] == k)
                flat = rows[:, :, fold_samples].reshape(size, -1)
                normal[k] += flat @ flat.T
                gradient[k] += flat @ white[:, fold_samples].ravel()
            residuals.append(residual)
        return np.concatenate(residuals, 1), (normal, gradient)


@dataclass(frozen=True)
class ChunkedCalibration:
    """A calibrated robot from all samples of a long recording.

    `thin` is the calibration of the samples that were spread over it, which chose the stages; `solution`, `fit` and
    `held_out` are of all n samples; `residual` (m, n) of the fit, mm and rad.
    """

    chunks: Chunks
    thin: Calibration
    stream: Stream
    solution: Solution
    fit: dict
    held_out: dict
    nominal: dict
    residual: np.ndarray

    @cached_property
    def noise(self) -> NoiseReport:
        """The residual of all samples against the stated noise; its structure is that of the thinned samples."""
        thin = self.thin.noise.findings
        position = self.residual[:3]
        degrees = self.solution.fit.degrees * position.size / self.residual.size
        corrected = (position**2).sum(0) * position.size / max(degrees, 1.0)
        stated = self.stream.stated_sigma
        if stated is None:
            test = None
        else:
            test = variance_test(position / stated[:3], degrees)
        return report(
            replace(
                thin,
                test=test,
                residual=robust_sigma(corrected, len(position)),
                residual_rms=float(np.sqrt(corrected.mean() / len(position))),
                degrees=degrees,
                rms=self.fit["rms_mm"],
            )
        )

    def as_json(self) -> dict:
        """The object of `calibrate --json`, of all samples; `stages` are as the thinned samples chose them."""
        answer = self.thin.as_json()
        known = self.solution.known
        return answer | {
            "command": "calibrate-large",
            "recording": self.chunks.head.name,
            "samples": self.chunks.n,
            "samples_for_stages": self.chunks.thin.n,
            "parameters": parameter_rows(self.solution),
            "fit": self.fit,
            "held_out": self.held_out,
            "nominal": self.nominal,
            "converged": self.solution.converged,
            "outcome": self.solution.outcome,
            "undetermined": list(self.solution.null_sentences),
            "observability": known.observability(self.chunks.n),
            "noise": self.noise.as_json(),
            "warnings": [*self.thin.warnings, *self.noise.warnings],
        }


def calibrate_chunks(
    folder: Path,
    plan: Path | tuple[Stage, ...] | None = None,
    folds: int = 10,
    progress: Callable[[str], None] = lambda text: None,
    trust_data: bool = False,
) -> ChunkedCalibration:
    """Calibrate the robot of a recording folder whose samples are too many for memory.

    plan, folds, progress, trust_data: as of `workbench.jobs.robot.calibrate.calibrate`.
    Held-out errors: a fold's parameters are
    those of all samples less one Newton step of its own normal equations (the infinitesimal jackknife's next order:
    Cook & Weisberg, Residuals and Influence in Regression, 1982, sec. 3.4), which is exact where the model is linear
    over it. Raises InputError.
    """
    progress("reading and checking the samples")
    chunks = read_chunks(folder, trust_data)
    progress(f"stages on {chunks.thin.n:,} of {chunks.n:,} samples")
    thin = calibrate(chunks.thin, plan, folds=folds, progress=progress, trust_data=trust_data)
    stream = stream_of(chunks, thin, progress)
    estimable = _wanted(thin, stream)
    free, _ = independent(
        stream.linearise(estimable)[1].normal, estimable, redundant=redundant_geometry(thin.robot)
    )
    fit = solve(stream, free)
    held_out = _held_out(stream, fit, _folds(chunks.pose, folds), folds)
    full_fit = estimable.take_over(fit.parameters).only(estimable.mask)
    known = identifiability(stream.linearise(full_fit)[1].normal, full_fit)
    provenance = dict(thin.provenance) | {"samples": str(chunks.n)}
    solution = Solution(fit.parameters, fit, known, provenance)
    nominal = error_summary(_nominal(stream))
    return ChunkedCalibration(
        chunks, thin, stream, solution, error_summary(fit.residual), held_out, nominal, fit.residual
    )


def stream_of(chunks: Chunks, thin: Calibration, progress: Callable[[str], None]) -> Stream:
    """All samples under the model that the thinned ones chose, with the sigma that they honestly have."""
    effects = thin.model.effects
    if any(effect.port == NOISE for effect in effects):
        raise InputError(
            "plan: expected no effect on the noise for a calibration in chunks, found one; take it out"
        )
    by_moves = [effect.effect for effect in effects if effect.by_moves]
    if by_moves:
        raise InputError(
            f"plan: expected no effect of the last moves for a calibration in chunks, which sees no "
            f"sample's predecessor, found {by_moves[0]}; take it out"
        )
    chain = thin.model.chain
    stated = 0 * chain.stated_sigma if chain.sigma_unknown else chain.stated_sigma
    extra = np.median(chain.sigma**2 - stated**2, axis=1)
    return Stream(chunks, thin.robot, chain.start, effects, extra, paced(progress, "sample"))


def _wanted(thin: Calibration, stream: Stream) -> Parameters:
    """All that the kept stages freed, also what the thinned samples tied to others, at their solution."""
    keys = set(thin.solution.all_known.keys)
    start = stream.parameters.take_over(thin.solution.parameters)
    return start.only(np.array([key in keys for key in start.keys]))


def _folds(pose: np.ndarray, folds: int) -> np.ndarray:
    """(n,) fold of each sample by its pose, whose repeats so stay together."""
    return np.unique(pose, return_inverse=True)[1].ravel() % folds


def _held_out(stream: Stream, fit: Fit, fold: np.ndarray, folds: int) -> dict:
    """Error summary of every sample predicted without its fold."""
    parameters = fit.parameters
    _, (normal, gradient) = stream.by_fold(parameters, fold, folds)
    scale = parameters.typical[parameters.mask]
    prior = parameters.precision[parameters.mask] * max(fit.sigma_scale, 1.0) ** 2
    pull = prior * (parameters.pack() - parameters.nulls[parameters.mask])
    moved = []
    for k in range(folds):
        normal_without = (normal.sum(0) - normal[k] + np.diag(prior)) * np.outer(
            scale, scale
        ) + _FLOOR * np.eye(len(scale))
        step = (
            solve_positive(normal_without, (gradient.sum(0) - gradient[k] + pull) * scale) * scale
        )
        moved.append(parameters.unpack(parameters.pack() - step))
    residuals = []
    for columns, model in stream.models():
        fold_numbers = fold[columns]
        rows = [np.flatnonzero(fold_numbers == k) for k in range(folds)]
        residuals += [
            model.at(samples_of_fold).residual(moved[k])
            for k, samples_of_fold in enumerate(rows)
            if samples_of_fold.size
        ]
    return error_summary(np.concatenate(residuals, 1)) | {
        "folds": folds,
        "samples": stream.chunks.n,
    }


def _nominal(stream: Stream) -> np.ndarray:
    """Residual of the nominal geometry with base and tool fitted."""
    bare = replace(stream, effects=())
    free = bare.parameters.free(*frames_of(bare.parameters))
    return solve(bare, free).residual


def save(calibration: ChunkedCalibration, folder: Path) -> None:
    """Write parameters.toml, calibration.json and solution.json, which `compensate` and `export` read."""
    full = replace(
        calibration.thin,
        solution=calibration.solution,
        fit=calibration.fit,
        held_out=calibration.held_out,
        nominal=calibration.nominal,
    )
    parameters = calibration.solution.parameters.to_toml()
    _write_json(folder / NAME, solution_keys(full, calibration.noise))
    (folder / "parameters.toml").write_text(parameters, encoding="utf-8")
    _write_json(folder / "calibration.json", calibration.as_json())


def _write_json(path: Path, keys: dict) -> None:
    path.write_text(json.dumps(keys, indent=1), encoding="utf-8")


__all__ = ["CONVERGED", "ChunkedCalibration", "Stream", "calibrate_chunks", "save", "stream_of"]
