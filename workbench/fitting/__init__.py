"""Common parts of all fits: checks of the samples, plausibility, the start, the plan with its stages,
gauge freedoms, shrinkage, cross-validation, limits of corrections, and the verdict; in this order."""
