"""Objectives as published, kept small: what the calibration of this project is compared with."""
