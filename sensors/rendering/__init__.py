"""The synthetic sensor: images of boards, of stripes on boards, and of scans, with the truth known."""

from sensors.rendering.instrument import Chip, Instrument, Lamp, Laser, Optics, sweeping_mirror
from sensors.rendering.patterns import Pattern
from sensors.rendering.ports import Causes, Moment, make_causes
from sensors.rendering.recording import Made, Stations, make_recording
from sensors.rendering.render import lamp_light, laser_light, render_board, render_scan
from sensors.rendering.scene import Scene, read_scene
from sensors.rendering.surfaces import BallSurface, BoardSurface, MeshSurface, true_balls

__all__ = [
    "BallSurface",
    "BoardSurface",
    "Causes",
    "Chip",
    "Instrument",
    "Lamp",
    "Laser",
    "Made",
    "MeshSurface",
    "Moment",
    "Optics",
    "Pattern",
    "Scene",
    "Stations",
    "lamp_light",
    "laser_light",
    "make_causes",
    "make_recording",
    "read_scene",
    "render_board",
    "render_scan",
    "sweeping_mirror",
    "true_balls",
]
