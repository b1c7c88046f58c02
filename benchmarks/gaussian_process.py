"""A Gaussian process on the residual of a geometric calibration: the published alternative to a model of physics.

Calibrate base, link geometry and tool; learn what is left as a function of the joint angles. This corrects an arm
without any law (Alvarez & Lawrence, J. Mach. Learn. Res. 12 (2011) 1459; for industrial arms Jing et al., Robotics
Comput.-Integr. Manuf. 2016; Landgraf et al., IEEE CASE 2021, the data of `ur10_ipa_tmac_A`). Three independent outputs
share one kernel: a constant times a squared exponential or a Matern 3/2 kernel with a length for each input, plus
noise. Its numbers maximise the marginal likelihood (Rasmussen & Williams, Gaussian Processes for Machine Learning
(2006), eq. 5.8 and 5.9), from two starts and both kernels; the more probable one is taken.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.optimize import minimize

_LEARNED = 400  # samples from which the kernel's numbers are learned
_KEPT = 3000  # samples that predict
_JITTER = 1e-8


@dataclass(frozen=True)
class Kernel:
    """`kind` "rbf" or "matern"; `log_size`, `log_noise`: of the standard deviations; `log_length` (D,)."""

    kind: str
    log_size: float
    log_noise: float
    log_length: np.ndarray

    @classmethod
    def of(cls, kind: str, packed: np.ndarray) -> "Kernel":
        """From its numbers as one vector (D + 2,)."""
        return cls(kind, float(packed[0]), float(packed[1]), packed[2:])

    def between(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """(A, B) covariance of the function at inputs (A, D) and (B, D)."""
        return np.exp(2 * self.log_size) * _shape(self.kind, self._squares(first, second))

    def _squares(self, first, second) -> np.ndarray:
        a, b = first / np.exp(self.log_length), second / np.exp(self.log_length)
        squares = (a**2).sum(1)[:, None] + (b**2).sum(1)[None] - 2 * a @ b.T
        return np.maximum(squares, 0.0)

    def negative_log_likelihood(self, inputs, outputs) -> tuple[float, np.ndarray]:
        """-log p of outputs (N, K) at inputs (N, D), and its gradient (D + 2,) by the packed numbers."""
        squares = self._squares(inputs, inputs)
        signal = np.exp(2 * self.log_size) * _shape(self.kind, squares)
        noise = np.exp(2 * self.log_noise)
        total = signal + (noise + _JITTER * np.exp(2 * self.log_size)) * np.eye(len(inputs))
        factor = cho_factor(total, lower=True)
        weights = cho_solve(factor, outputs)
        count = outputs.shape[1]
        value = 0.5 * (outputs * weights).sum() + count * np.log(np.diag(factor[0])).sum()
        inner = count * cho_solve(factor, np.eye(len(inputs))) - weights @ weights.T
        slope = np.exp(2 * self.log_size) * _slope(self.kind, squares)
        gradient = [0.5 * (inner * 2 * signal).sum(), noise * np.trace(inner)]
        for column, length in zip(inputs.T, np.exp(self.log_length)):
            apart = ((column[:, None] - column[None]) / length) ** 2
            gradient.append(0.5 * (inner * slope * -2 * apart).sum())
        return float(value), np.array(gradient)


def _shape(kind: str, squares: np.ndarray) -> np.ndarray:
    """Correlation at squared distances in lengths."""
    if kind == "rbf":
        return np.exp(-0.5 * squares)
    root = np.sqrt(3 * squares)
    return (1 + root) * np.exp(-root)


def _slope(kind: str, squares: np.ndarray) -> np.ndarray:
    """Derivative of the correlation by the squared distance."""
    if kind == "rbf":
        return -0.5 * np.exp(-0.5 * squares)
    return -1.5 * np.exp(-np.sqrt(3 * squares))


def learn(inputs: np.ndarray, outputs: np.ndarray) -> Kernel:
    """The likeliest kernel for outputs (N, K) with mean 0 at inputs (N, D), from at most `_LEARNED` of them."""
    chosen = np.random.default_rng(0).permutation(len(inputs))[:_LEARNED]
    x, y = inputs[chosen], outputs[chosen]
    spread = np.maximum(x.std(0), 1e-6)
    size = np.log(np.maximum(y.std(), 1e-9))
    bounds = [(size - 7, size + 3), (size - 9, size + 1), *((s - 4, s + 5) for s in np.log(spread))]
    best = (np.inf, None)
    for kind in ("rbf", "matern"):
        for length in (0.5, 3.0):
            start = np.concatenate([[size, size - 1], np.log(length * spread)])

            def objective(packed, kind=kind):
                return Kernel.of(kind, packed).negative_log_likelihood(x, y)

            found = minimize(
                objective,
                start,
                jac=True,
                bounds=bounds,
                method="L-BFGS-B",
                options={"maxiter": 80},
            )
            if found.fun < best[0]:
                best = (float(found.fun), Kernel.of(kind, found.x))
    return best[1]


def predict(
    kernel: Kernel, inputs: np.ndarray, outputs: np.ndarray, wanted: np.ndarray
) -> np.ndarray:
    """(M, K) mean of the process at `wanted` (M, D), given outputs (N, K) at inputs (N, D)."""
    step = -(-len(inputs) // _KEPT)
    x, y = inputs[::step], outputs[::step]
    total = kernel.between(x, x) + np.exp(2 * kernel.log_noise) * np.eye(len(x))
    total[np.diag_indices_from(total)] += _JITTER * np.exp(2 * kernel.log_size)
    factor = np.linalg.cholesky(total)
    weights = solve_triangular(factor, y, lower=True)
    across = solve_triangular(factor, kernel.between(x, wanted), lower=True)
    return across.T @ weights
