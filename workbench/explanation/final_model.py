"""Residuals of a diagnosis' baseline and final model, and what follows from them: noise, lack of fit, what is drawn."""

from dataclasses import replace

import numpy as np

from robot_model.effects.friction import ReadingLattice
from workbench.diagnosis.linear.problem import Finding, Found
from workbench.diagnosis.noise.rounded_readings import rounding_variance
from workbench.diagnosis.validation.left_out_blocks import variance_factor
from workbench.diagnosis.validation.terms import Proof
from workbench.explanation.noise import replicates, stated_noise
from workbench.explanation.noise.local_structure import local_structure
from workbench.explanation.result import Views
from workbench.explanation.term_steps import steps_of_terms
from workbench.fitting.verdicts.verdict import AS_STATED, WITH_ROUNDING

SENSOR_CHAIN = ("camera", "laser", "mirror", "sensor", "artefact")


class FinalModel:
    """The residuals of baseline and final model of a bench, and what follows from them."""

    def __init__(self, bench, found: Found, unit: str, terms=None):
        self.bench, self.unit, self.found, self.terms = bench, unit, found, terms
        self.before = found.before
        if terms is None:
            self.after = found.after
        else:
            effects = [e for term in terms for e in term.finding.effects]
            self.after = bench.problem(effects, hypotheses=False).conditional_on()

    @property
    def noise(self) -> tuple[float, str]:
        """RMS distance (mm, px) that the instrument leaves, and how it is known."""
        inliers = ~self.found.outliers
        if self.bench.chain is None:
            return self.bench.noise(inliers)
        residuals = residuals_of(self.after)
        recording = self.bench.recording
        position = residuals[:3, inliers]
        degrees = self.after.degrees * len(position) / len(residuals)
        pose = self.bench.pose[inliers]
        index = self._index()[inliers]
        sigma = stated_sigma(recording)
        rounding = self._rounding()
        if sigma is None or rounding is None:
            return replicates.noise(pose, index, position, sigma, degrees)
        sigma = float(np.sqrt(sigma**2 + (rounding[:3, inliers] ** 2).mean()))
        noise, source = replicates.noise(pose, index, position, sigma, degrees)
        return noise, source + WITH_ROUNDING * (source == AS_STATED)

    @property
    def is_noise_unknown(self) -> bool:
        """Whether neither the recording nor replicates say how large the noise is."""
        return self.noise[1] == replicates.UNKNOWN

    @property
    def has_rounding(self) -> bool:
        """Whether rounded readings were found: their errors have directions of their own, as noise of angles has."""
        return any(finding.effect == ReadingLattice.effect for finding in self.found.noise_findings)

    def _rounding(self) -> np.ndarray | None:
        """(m, n) mm, standard deviation of each coordinate by the rounding of readings; None where none was found."""
        if not self.has_rounding:
            return None
        squares = rounding_variance(self.before) * unwhitened(self.before) ** 2
        return np.sqrt(squares).reshape(-1, self.before.n)

    def with_noise(self, proof: Proof) -> Proof:
        """The proof with the noise of the final model, and what the uncertainty of the parameters adds to it.

        Terms that were refused may follow the noise of single repeats, and take structure off what remains.
        """
        inliers = ~self.found.outliers
        factors = tuple(variance_factor(p, proof.fold, inliers) for p in (self.before, self.after))
        noise, source = self.noise
        if source in (replicates.FROM_REPLICATES, replicates.UNKNOWN):
            proof = replace(proof, noise=noise)
        return replace(proof, variance_factors=factors)

    def stated_noise(self) -> stated_noise.StatedNoise | None:
        """Comparison of the residuals of the final model with the stated sigma; None where none is stated."""
        if (
            self.bench.chain is None
            or self.bench.chain.sigma_unknown
            or stated_sigma(self.bench.recording) is None
        ):
            return None
        residuals = residuals_of(self.after)
        rows = slice(0, min(3, len(residuals)))  # of poses the position: what `sigma_mm` states
        sigma = self.bench.chain.stated_sigma[rows, : self.before.n]
        rounding = self._rounding()
        if rounding is not None:
            sigma = np.hypot(sigma, rounding[rows])
        white = residuals[rows] / sigma
        if not np.isfinite(white).all():
            return None
        degrees = self.after.degrees * white.size / residuals.size
        shares = residual_covariances(self.after)[:, rows, rows]
        return stated_noise.StatedNoise(
            white, degrees, ~self.found.outliers, self.bench.pose, self._index(), shares
        )

    def local_structure(self) -> Finding | None:
        """Structure that makes the residual of neighbouring poses alike; None where there is none."""
        chain = self.bench.chain
        model, fit, _ = self.bench.solve(self.before.effects)
        values = fit.parameters.values[: len(chain.parameters)]
        evaluation = model.chain.evaluate(values, {})
        residual = np.zeros((3, self.before.n))
        points = model.chain.to_root(values, evaluation, residual)[0]
        return local_structure(self.after, self.before, points)

    def _index(self):
        return self.bench.chain.state.index[: self.before.n]

    def lack(self):
        """Lack of fit of baseline and final model against replicates; None without these."""
        if self.bench.chain is None:
            return None
        rows = {
            name: replicates.lack_of_fit(
                self.bench.pose, self._index(), residuals_of(p)[:3], _rank(p)
            )
            for name, p in (("before", self.before), ("after", self.after))
        }
        return rows if all(rows.values()) else None

    @property
    def ids(self) -> np.ndarray:
        """(n,) numbers of the samples."""
        if self.bench.chain is None:
            return np.arange(self.before.n)
        return self.bench.recording.sample_ids

    def outliers(self) -> tuple[int, ...]:
        """Sample numbers of those that nothing brings near."""
        return tuple(int(i) for i in self.ids[self.found.outliers])

    def views(self) -> Views:
        """Data of the figures of the page."""
        if self.bench.chain is None:
            return self._sensor_views()
        chain = self.bench.chain
        model, fit, _ = self.bench.solve(self.before.effects)
        chain_values = fit.parameters.values[: len(chain.parameters)]
        points = model.chain.to_root(
            chain_values, model.chain.evaluate(chain_values, {}), np.zeros((3, self.before.n))
        )[0]
        named = [f"joint-{k}" for k in range(1, chain.robot.joints + 1)]
        places = (
            "base",
            *(w for k, joint in enumerate(named, 1) for w in (joint, f"link-{k}")),
            "tool",
            *(("sensor", "artefact") if chain.measurement.place == "sensor" else ()),
        )
        before = residuals_of(self.before)
        after = residuals_of(self.after)
        if self.before.rotation is not None:
            rotation = before[3:], after[3:]
        else:
            rotation = None
        return Views(
            before[:3],
            after[:3],
            points,
            _with_units_of_slides(_plain(self.before), chain),
            places,
            self.bench.recording.sample_ids,
            self._links(),
            ("x", "y", "z") if len(before) >= 3 else ("residual",),
            rotation,
            steps=steps_of_terms(
                self.bench, self.terms or (), residuals_of, self.before, self.after
            ),
            rounding=self._rounding(),
        )

    def _links(self):
        """(3, J+2) mm: the arm at the pose nearest to the middle of all, root frame."""
        state = self.bench.chain.state
        middle = np.median(state.variables, axis=1, keepdims=True)
        middle_sample = int(np.argmin(((state.variables - middle) ** 2).sum(0)))
        frames = state.frames
        return np.vstack(
            [
                frames.pivot[:1, :, middle_sample],
                frames.origin[:, :, middle_sample],
                frames.end_origin[None, :, middle_sample],
            ]
        ).T

    def _sensor_views(self) -> Views:
        before, after = (residuals_of(p) for p in (self.before, self.after))
        points = np.stack(
            [self.before.covariates.get(c, np.zeros(self.before.n)) for c in ("u", "v")]
        )
        return Views(
            before,
            after,
            points,
            self._own_covariates(),
            SENSOR_CHAIN,
            np.arange(self.before.n),
            None,
            ("u", "v", "along")[: len(before)],
        )

    def _own_covariates(self) -> dict:
        """Covariates that vary; nan at samples of images that have none, such as the place on the board of a ball."""
        described = self.bench.described
        return {
            name: np.where(described[name], values, np.nan)
            for name, values in _plain(self.before).items()
        }


def _plain(problem) -> dict:
    """Covariates that vary, each listed once."""
    out = {}
    for name, x in problem.sample_covariates.items():
        if np.ptp(x) > 0 and not any(np.array_equal(x, other) for other in out.values()):
            out[name] = x
    return out


def _with_units_of_slides(covariates: dict, chain) -> dict:
    """Covariates by name, in which positions and moves of prismatic joints carry their unit: "q1_mm"."""
    slides = [k for k in range(1, chain.robot.joints + 1) if chain.slides(k)]
    renamed = {f"{kind}{k}": f"{kind}{k}_mm" for kind in ("q", "move") for k in slides}
    return {renamed.get(name, name): x for name, x in covariates.items()}


def _rank(problem) -> int:
    """Of the baseline, of which the position spends its share where orientation is measured, too."""
    rank = problem.rank
    if problem.rotation is None:
        return rank
    return round(rank * float((~problem.rotation).mean()))


def residuals_of(problem) -> np.ndarray:
    """(m, n) residual in mm (px), not weighted; nan where a sample has fewer coordinates than others."""
    value = problem.residual * unwhitened(problem)
    order = np.argsort(problem.sample, kind="stable")
    counts = np.bincount(problem.sample, minlength=problem.n)
    place = np.empty(len(value), int)
    place[order] = np.arange(len(value)) - np.repeat(np.cumsum(counts) - counts, counts)
    out = np.full((counts.max(), problem.n), np.nan)
    out[place, problem.sample] = value
    return out


def residual_covariances(problem) -> np.ndarray:
    """(n, m, m) covariance of the residual of each sample, I - Q_i Q_i', of noise with the unit matrix.

    Q (N, R): basis of the column space of the fit. All samples have m coordinates, in the order of `residuals_of`.
    """
    order = np.argsort(problem.sample, kind="stable")
    coordinates, rank = len(order) // problem.n, problem.full_basis.shape[1]
    basis = problem.full_basis[order].reshape(problem.n, coordinates, rank)
    return np.eye(basis.shape[1]) - basis @ basis.swapaxes(1, 2)


def unwhitened(problem) -> np.ndarray:
    """(N,) what a whitened coordinate of the problem is worth in mm (px)."""
    return problem.sigma / np.sqrt(np.maximum(problem.weights, 1e-12))[problem.sample]


def stated_sigma(recording) -> float | None:
    """RMS of the stated 1 sigma of a coordinate."""
    if recording.sigma is None:
        return None
    return float(np.sqrt(np.mean(recording.sigma**2)))
