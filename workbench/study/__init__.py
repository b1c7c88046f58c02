"""Studies: many runs of the same thing with something varied, on any executor, kept as one table."""
