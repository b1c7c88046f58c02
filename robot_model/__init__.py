"""Arms: nominal robots, the chain with its ports, statics, effects, and how points are measured."""

from robot_model.files.loading import builtin_robots, load_robot
from robot_model.robot import Robot

__all__ = ["Robot", "builtin_robots", "load_robot"]
