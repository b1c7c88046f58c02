"""Mistakes in joint readings: constant or rounded columns, couplings between joints, and wrong scales."""
