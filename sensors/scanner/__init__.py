"""The calibrated scanner: from stripe pixels to points, its calibration, its file."""
