"""Core: parameters, effects, models and solvers for any measuring chain."""

VERSION = "0.3.0"
"""The version of the workbench; a build reads it here without importing anything."""
