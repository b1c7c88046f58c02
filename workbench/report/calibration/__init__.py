"""Page of a robot calibration: headline, errors, stages, parameters, residuals and the workspace."""
