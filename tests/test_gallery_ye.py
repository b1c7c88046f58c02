"""The sections on the scanner of the gallery page of Ye et al. 2024: statistics of repeated scans."""

import sys

import numpy as np
import pytest

from conftest import ROOT

sys.path.insert(0, str(ROOT / "tools"))

pytest.importorskip("mujoco", reason="MuJoCo is not installed")

import gallery_ye_scanner as scanner  # noqa: E402
import gallery_ye_sections as sections  # noqa: E402


def repeated(std_um, scans: int = 4000, seed: int = 0) -> dict:
    """Figures of scans whose centres scatter by std_um (3,), and whose points have radius errors of 6 um."""
    rng = np.random.default_rng(seed)
    points = rng.normal(1, 6, (scans, 50))
    return {
        "error_mm": (1e-3 * rng.normal(0.5, std_um, (scans, 3))).tolist(),
        "std_mm": np.tile(1e-3 * np.array(std_um), (scans, 1)).tolist(),
        "form_mm": [0.006] * scans,
        "histogram": [np.histogram(row, scanner.EDGES_UM)[0].tolist() for row in points],
    }


def test_standard_deviations_are_per_axis_and_in_space_without_the_mean():
    found = scanner.deviations({1: repeated([3.0, 4.0, 12.0])})
    np.testing.assert_allclose(found, [[3, 4, 12, 13]], rtol=0.05)


def test_the_table_of_repeatability_states_what_the_scans_have():
    rows = {ball: repeated([0.3, 0.4, 1.2]) for ball in scanner.RADII}
    lines = sections.repeatability({"balls": rows}).splitlines()[2:]
    assert len(lines) == 4
    cells = [cell.strip() for cell in lines[1].split("|")[1:-1]]
    assert cells[:3] == ["2", "15.002", "4000"]
    in_space, stated, mean = (float(cell) for cell in cells[6:9])
    assert [in_space, stated, mean] == pytest.approx([1.3, 1.3, 0.5 * np.sqrt(3)], rel=0.06)
    assert sections.radius_errors(rows[1]) == pytest.approx((1, 6), rel=0.05)


@pytest.mark.long
def test_scans_of_a_ball_are_within_their_stated_uncertainty(tmp_path, monkeypatch):
    """One block of four scans from images: errors of the centre by its stated standard deviations."""
    monkeypatch.setattr(scanner, "SCANS", 4)
    calibrated = scanner._calibrate(tmp_path)
    found = scanner._measure(tmp_path, calibrated, 2, 99)
    ratio = np.array(found["error_mm"]) / np.array(found["std_mm"])
    assert 0.3 < np.sqrt((ratio**2).mean()) < 1.8
    assert np.sqrt(np.mean(np.square(found["form_mm"]))) < 0.0114
