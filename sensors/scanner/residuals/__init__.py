"""Residuals of stripe centres: lack of fit, dependence on the line's width and brightness, rejected points."""
