"""Interpretation of columns: units, robot, rotation convention, decided by fits to the robot or asked for."""
