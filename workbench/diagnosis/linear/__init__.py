"""The linearised problem: residual and candidates of a fitted baseline as columns, their evidence, and where it sits.

`candidates` are the columns to be compared with the residual, `problem` holds all arrays; `hypotheses` ranks laws
of the library and smooth nonparametric alternatives, and says at which place of the chain a mismatch sits; `evidence`
weighs each from inner products. An alternative is a function of one or two covariates at a place: an effect that is not
in the library must not get the name of the least bad law.
"""
