"""A tilted window before the camera is named with its tilt, and not a lens that is distorted."""

import numpy as np
import pytest

import sensor_virtual
from sensors.effects import CATALOGUE
from simulated_images import simulated
from workbench.diagnosis.scanner import sensor
from workbench.diagnosis.search.select import find

THICKNESS = "camera.window-refraction.thickness"
TILT_DEG = [9.0, -14.0]


def tilted():
    return CATALOGUE["window-refraction"]("camera", tilt_deg=TILT_DEG)


def test_the_series_in_the_tilt_is_the_law_but_for_the_third_order():
    state = sensor_virtual.chains().corners.state
    tilt = np.deg2rad(TILT_DEG)
    of_tilt = [1, *tilt, tilt[0] ** 2, tilt[0] * tilt[1], tilt[1] ** 2]
    series = CATALOGUE["window-refraction"]("camera", unknown_tilt=True).basis(state)
    law = tilted().basis(state)[0]
    assert np.einsum("p,pkn->kn", of_tilt, series) == pytest.approx(
        law, abs=0.1 * np.abs(law).max()
    )


def test_a_tilted_window_is_named_with_its_tilt():
    chains = simulated(sensor_virtual.chains(), (tilted(),), {THICKNESS: 1.0}, 7)
    found = find(sensor.SensorBench(chains))
    assert [(one.effect, one.where) for one in found.findings] == [("window-refraction", "camera")]
    assert found.findings[0].effects[0].unknown_tilt
