"""Transforms of single links, as robot_state_publisher writes them, as the pose of the last link in the first frame.

A chain are transforms parent to child that follow one another, at least two of which change. It ends at the last frame
that moves against its parent, or at tool0 or flange where these are fixed to it.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from workbench.core.rigid import transform

Edge = tuple[str, str]
_ENDS = ("tool0", "flange")
_GAP_S = 0.02
_MOVES = 1e-9


def joined_chains(edges: Mapping[Edge, np.ndarray]) -> dict[Edge, np.ndarray]:
    """The transforms with every chain of moving links as one.

    edges: parent and child -> (n, 8) s, mm or m, and quaternion x y z w of each message. Transforms that never change
    are those of one message.
    """
    parents = {child: parent for parent, child in edges}
    moving = {edge for edge, rows in edges.items() if np.ptp(rows[:, 1:], axis=0).max() > _MOVES}
    made, used = dict(edges), set()
    ends = [child for _, child in moving if not any(parent == child for parent, _ in moving)]
    for end in ends:
        path = _path_to(end, parents)
        path = path[min(k for k, edge in enumerate(path) if edge in moving) :]
        if sum(edge in moving for edge in path) < 2:
            continue
        path += _extension(end, edges)
        made[path[0][0], path[-1][1]] = _composed([edges[edge] for edge in path], path, moving)
        used |= set(path)
    return {edge: rows for edge, rows in made.items() if edge not in used}


def _path_to(end: str, parents: Mapping[str, str]) -> list[Edge]:
    """The transforms from the root to a frame."""
    path: list[Edge] = []
    seen = {end}
    while (parent := parents.get(end)) is not None and parent not in seen:
        path.insert(0, (parent, end))
        seen.add(parent)
        end = parent
    return path


def _extension(end: str, edges: Mapping[Edge, np.ndarray]) -> list[Edge]:
    """The transform to tool0 or flange that is fixed to the last link; [] where there is none."""
    for name in _ENDS:
        if (end, name) in edges:
            return [(end, name)]
    return []


def _composed(transforms: Sequence[np.ndarray], path: Sequence[Edge], moving) -> np.ndarray:
    """(n, 8) of the product of transforms, at the times of the last one that moves where all others have a message."""
    last = max(k for k, edge in enumerate(path) if edge in moving)
    times = transforms[last][:, 0]
    poses, is_known = np.tile(np.eye(4), (len(times), 1, 1)), np.ones(len(times), bool)
    for edge, rows in zip(path, transforms):
        nearest = np.abs(rows[:, :1] - times).argmin(0)
        if edge in moving:
            is_known &= np.abs(rows[nearest, 0] - times) <= _GAP_S
        rotations = Rotation.from_quat(rows[nearest, 4:]).as_matrix()
        poses = poses @ transform(rotations, rows[nearest, 1:4])
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    return np.column_stack([times, poses[:, :3, 3], quaternions])[is_known]
