"""Priors whose scale the data determine: posterior of a linear fit, shrinkage, wider priors for large effects."""
