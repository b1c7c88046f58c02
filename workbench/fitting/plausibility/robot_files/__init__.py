"""Contradictions between a recording and its robot file: dimensions, the whole geometry, the direction of gravity."""
