"""Effects that a blind case plants: independent laws of joints, bodies and data, and their places."""
