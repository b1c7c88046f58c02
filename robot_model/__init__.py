"""Arms: nominal robots, the chain with its ports, statics, effects, and how points are measured."""

from robot_model.robot import Robot, builtin_robots, load_robot

__all__ = ["Robot", "builtin_robots", "load_robot"]
