"""The linearised problem: residual and candidates of a fitted baseline as columns, their evidence, and where it sits.

`problem` holds the arrays; `hypotheses` lists all that might be missing, laws of the library and smooth
nonparametric alternatives (functions of one or two covariates at a place: what no row of the library makes must not
get the name of the row that is least bad); `evidence` weighs each from inner products; `locate` says at which place of
the chain a mismatch sits.
"""
