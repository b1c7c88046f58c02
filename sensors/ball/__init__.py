"""Balls in clouds: fitted, detected, identified."""
