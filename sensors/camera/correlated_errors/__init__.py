"""Errors that many corners share: variance components, displaced board lines, and their part of the covariance."""
