"""Core: parameters, effects, models and solvers for any measuring chain."""
