"""The error as a volume over the workspace: right values between the poses, none where no pose is near."""

import numpy as np
import pytest

from workbench.report.calibration.volume import volume, write_volume


@pytest.fixture(scope="module")
def places() -> np.ndarray:
    """(3, n) places in a shell around a base: nothing inside 300 mm."""
    drawn = np.random.default_rng(0).uniform(-600, 600, (3, 6000))
    away = np.linalg.norm(drawn, axis=0)
    return drawn[:, (away > 300) & (away < 600)]


def test_between_the_poses_the_error_is_that_of_its_neighbours(places):
    slope = np.array([1e-3, -5e-4, 2e-3])
    grid = volume(places, 2.0 + slope @ places)
    away = np.linalg.norm(grid.points, axis=1)
    inside = (away > 380) & (away < 520)
    shown = grid["error_mm"][inside]
    assert np.isfinite(shown).all()
    assert np.abs(shown - 2.0 - grid.points[inside] @ slope).max() < 0.1


def test_where_no_pose_is_near_there_is_no_value(places):
    grid = volume(places, np.ones(places.shape[1]))
    assert np.isnan(grid["error_mm"][np.linalg.norm(grid.points, axis=1) < 80]).all()


def test_the_volume_opens_again(places, tmp_path):
    import pyvista

    error = np.abs(places[2]) / 1000
    drawn = write_volume(
        places, error, np.array([[0.0, 0, 300], [0, 0, 0], [0, 400, 400]]), tmp_path, "workspace"
    )
    again = pyvista.read(tmp_path / "workspace.vti")
    np.testing.assert_array_equal(again["error_mm"], volume(places, error)["error_mm"])
    assert (
        drawn is None or drawn.stat().st_size > 10_000
    )  # None: a machine that draws nothing, as the log says
