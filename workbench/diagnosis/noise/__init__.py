"""Noise of the residual: outliers, variance that depends on a covariate, and random effects.

`data_findings` tests for outliers and heteroscedastic noise (`outliers`); `random_effects` for a place that
varies at random from sample to sample; `serial_correlation` estimates the correlation from pose to pose;
`rounded_readings` tests for rounded joint readings.
"""
