"""Bias of the stripe centre on a curved or tilted surface, and the brightness of the surface."""
