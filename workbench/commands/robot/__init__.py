"""Commands about a robot arm: calibrate, compare, compensate, diagnose, export, identifiability,
poses, significance and simulate."""
