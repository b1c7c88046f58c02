"""Uncertainty of a hand-eye transform: parameter covariance, flange-pose variances, and errors that images share."""
