"""Calibration boards in pictures: found, with sub-pixel corners and their sigma."""
