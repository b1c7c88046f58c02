"""Postures of an arm: which solution of the inverse kinematics, position before orientation, and collisions."""
