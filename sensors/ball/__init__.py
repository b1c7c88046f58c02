"""Balls in clouds: fitted, found, told apart."""
