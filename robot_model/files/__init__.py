"""Nominal arms from files: robot.toml, URDF, MJCF, or a built-in arm by its name (`loading`)."""
