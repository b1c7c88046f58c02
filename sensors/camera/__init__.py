"""The camera: its model and exact inverse, and its calibration by bundle adjustment."""
