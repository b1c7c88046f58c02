"""Studies: many runs with varied parameters, on any executor, collected in one table."""
