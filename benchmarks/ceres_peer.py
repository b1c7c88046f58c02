"""Ceres through pyceres, with the analytic Jacobian of our model: only the solvers differ."""

import numpy as np
import pyceres


class Residuals(pyceres.CostFunction):
    """All whitened residuals as one block, so that Python is called once a step."""

    def __init__(self, model, free, sigma):
        super().__init__()
        self.model, self.free, self.sigma = model, free, sigma
        self.scale = free.typical[free.mask]
        self.set_num_residuals(sigma.size)
        self.set_parameter_block_sizes([len(self.scale)])

    def at(self, x):
        """Parameters at scaled numbers x (F,)."""
        return self.free.unpack(x * self.scale)

    def evaluate(self, parameters, residuals, jacobians):
        """Called by Ceres: fill residuals (m,) and, where asked for, the Jacobian (m F,) row by row."""
        here = self.at(np.asarray(parameters[0]))
        if jacobians is None:
            residuals[:] = (self.model.residual(here) / self.sigma).ravel()
            return True
        residual, rows = self.model.linearise(here)
        residuals[:] = (residual / self.sigma).ravel()
        rows = (rows / self.sigma).reshape(len(rows), -1)
        jacobians[0][:] = (rows.T * self.scale).ravel()
        return True

    Evaluate = evaluate  # the name by which pyceres calls it


def fit(model, free):
    """Parameters at the minimum that Ceres finds (Levenberg-Marquardt, normal equations by Cholesky)."""
    cost = Residuals(model, free, model.sigma(free))
    x = free.pack() / cost.scale
    problem, options, summary = pyceres.Problem(), pyceres.SolverOptions(), pyceres.SolverSummary()
    problem.add_residual_block(cost, None, [x])
    options.linear_solver_type = pyceres.LinearSolverType.DENSE_NORMAL_CHOLESKY
    options.num_threads, options.logging_type = 1, pyceres.LoggingType.SILENT
    options.minimizer_progress_to_stdout = False
    pyceres.solve(options, problem, summary)
    return cost.at(x)
