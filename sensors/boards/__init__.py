"""Calibration boards in images: found, with sub-pixel corners and their sigma."""
