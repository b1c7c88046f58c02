"""The ground floor: parameters, effects, models and solves, for any measuring chain."""
