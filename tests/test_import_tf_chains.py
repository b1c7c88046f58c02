"""Transforms of single links of a robot as the pose of its flange."""

import numpy as np
from scipy.spatial.transform import Rotation

from datasets.importers.sources.tf_chains import joined_chains
from workbench.core.rigid import transform

TIMES = np.arange(20) / 10


def rows_of(poses: np.ndarray, times=TIMES) -> np.ndarray:
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    return np.column_stack([times, poses[:, :3, 3], turns])


def links(rng, count: int = 20) -> np.ndarray:
    turns = Rotation.from_rotvec(rng.normal(size=(count, 3))).as_matrix()
    return transform(turns, rng.normal(size=(count, 3)))


def poses_in(rows: np.ndarray) -> np.ndarray:
    return transform(Rotation.from_quat(rows[:, 4:]).as_matrix(), rows[:, 1:4])


def test_links_become_the_pose_of_the_flange():
    rng = np.random.default_rng(2)
    first, second, fixed = links(rng), links(rng), links(rng, 1)
    camera = links(rng)
    edges = {
        ("world", "base"): rows_of(links(rng, 1), TIMES[:1]),
        ("base", "link_1"): rows_of(first),
        ("link_1", "link_2"): rows_of(second, TIMES + 0.001),
        ("link_2", "tool0"): rows_of(fixed, TIMES[:1]),
        ("camera", "marker"): rows_of(camera),
    }
    made = joined_chains(edges)
    assert set(made) == {("world", "base"), ("base", "tool0"), ("camera", "marker")}
    assert np.allclose(poses_in(made["base", "tool0"]), first @ second @ fixed)
    assert np.allclose(made["base", "tool0"][:, 0], TIMES + 0.001)


def test_messages_without_one_of_the_links_are_left_out():
    rng = np.random.default_rng(3)
    edges = {("base", "a"): rows_of(links(rng)), ("a", "b"): rows_of(links(rng), TIMES + 1.0)}
    assert len(joined_chains(edges)["base", "b"]) == 10


def test_a_single_transform_and_a_loop_stay():
    rng = np.random.default_rng(4)
    edges = {("base", "tool0"): rows_of(links(rng))}
    assert set(joined_chains(edges)) == set(edges)
    loop = {("a", "b"): rows_of(links(rng)), ("b", "a"): rows_of(links(rng))}
    assert set(joined_chains(loop)) == set(loop)
