"""The linearised problem: residual and candidates of a fitted baseline as columns, their evidence, and their places.

`candidates` defines the columns that are compared with the residual, `problem` contains all arrays; `evidence`
computes the evidence of a candidate from inner products; `hypotheses` ranks effects of the catalogue and smooth
nonparametric alternatives, and locates the discrepancy in the measuring chain. An alternative is a function of one or
two covariates at a place. Without it, an effect that is not in the catalogue would be reported as the least bad one.
"""
