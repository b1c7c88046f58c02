"""A recording compared with a simulation or an earlier solution: parameters, unmodelled effects, noise."""
