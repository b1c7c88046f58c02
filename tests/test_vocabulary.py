"""Names of places and covariates, and what they say."""

import pytest

from workbench.core.vocabulary import Covariate, Place

PLACES = {"base": Place("base"), "joint-3": Place("joint", 3), "ball-12": Place("ball", 12)}
COVARIATES = {
    "q3_deg": Covariate("q", Place("joint", 3), "deg"),
    "q3": Covariate("q", Place("joint", 3)),
    "qdot2_deg_s": Covariate("qdot", Place("joint", 2), "deg_s"),
    "approach6": Covariate("approach", Place("joint", 6)),
    "tau1": Covariate("tau", Place("joint", 1)),
    "torque4_nm": Covariate("torque", Place("joint", 4), "nm"),
    "moment2_x": Covariate("moment", Place("link", 2), component="x"),
    "moment_y": Covariate("moment", component="y"),
    "seen_z": Covariate("seen", component="z"),
    "temperature_c": Covariate("temperature", unit="c"),
    "temperature_j2_c": Covariate("temperature", Place("joint", 2), "c"),
    "temperature_link3_c": Covariate("temperature", Place("link", 3), "c"),
    "temperature_artefact_c": Covariate("temperature", Place("artefact"), "c"),
    "accel_plate_x_m_s2": Covariate("acceleration", Place("plate"), "m_s2", "x"),
    "time_s": Covariate("time", unit="s"),
    "payload_kg": Covariate("payload", unit="kg"),
    "row": Covariate("row"),
    "gripper_state": Covariate("gripper_state"),
}


@pytest.mark.parametrize("name", PLACES)
def test_a_place_is_read_and_written(name):
    assert Place.of(name) == PLACES[name] and str(PLACES[name]) == name


@pytest.mark.parametrize("name", COVARIATES)
def test_a_covariate_is_read(name):
    assert Covariate.of(name) == COVARIATES[name]


def test_signs_and_readings_are_known():
    names = ("time_s", "row", "approach2", "sweep", "q1_deg", "q1", "temperature_c")
    found = [Covariate.of(name) for name in names]
    assert [c.is_signed for c in found] == [False, False, True, True, False, False, False]
    assert [c.is_reading for c in found] == [False, False, False, False, True, False, False]
