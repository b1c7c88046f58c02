"""Files of an arm for layers that may not import `robot_model`: schema of robot.toml, URDF and MJCF, built-in names."""
