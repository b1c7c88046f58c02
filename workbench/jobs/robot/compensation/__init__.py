"""Corrected targets from a calibrated arm: readings that reach the target, their limits, and why a target has none."""
