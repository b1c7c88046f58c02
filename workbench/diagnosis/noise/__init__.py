"""What the residual says of the noise: outliers, variance that depends on a covariate, and random effects.

`data` asks for outliers and heteroscedastic noise (`outliers`, `contaminated`); `scatter` for a place that moves at
random from sample to sample; `replicates` and `stated_noise` compare the noise that is stated with the noise that
is found.
"""
