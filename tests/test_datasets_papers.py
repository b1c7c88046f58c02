"""The papers' tables: complete, and consistent with what the papers compute from them."""

import math

import numpy as np
import pytest

from datasets import InputError, papers


def test_every_paper_loads_and_names_its_source():
    assert papers.names() == ["gubankov-2022", "liu-2014", "mathematics-2023", "ye-2024"]
    for name in papers.names():
        assert papers.load(name)["source"]["where"]


def test_unknown_paper_is_a_sentence():
    with pytest.raises(InputError, match="gubankov-2022"):
        papers.load("gubankov")


@pytest.mark.parametrize(
    ("cloud", "published"), [("identified", 0.2262), ("controller", 0.2562), ("nominal", 0.6715)]
)
def test_gubankov_table_1_registers_as_published(cloud, published):
    """Centring and a rigid turn give the published spread to its last digit."""
    paper = papers.load("gubankov-2022")
    table = paper["table_1"]
    assert paper["registration"][f"{cloud}_mm"] == published
    assert papers.cloud(table, cloud).shape == (13, 3)
    rms = papers.registration_rms(papers.cloud(table, cloud), papers.cloud(table, "tracker"))
    assert round(rms, 4) == published


def test_registration_does_not_see_a_rigid_motion():
    points = np.random.default_rng(5).normal(size=(9, 3))
    turn = np.array([[0, -1, 0], [0, 0, 1], [-1, 0, 0]], float)
    moved = points @ turn.T + (1, 2, 3)
    assert papers.registration_rms(points, moved) < 1e-12
    mirrored = points * (1, 1, -1)
    assert papers.registration_rms(points, mirrored) > 0.1


def test_gubankov_counts_pairs_and_keeps_deviations_next_to_results():
    paper = papers.load("gubankov-2022")
    for robot in ("rv2fb", "ur10e"):
        pairs = sum(math.comb(n, 2) for n in paper[robot]["touches"])
        assert pairs == paper[robot]["pairs"]
        assert np.shape(paper[robot]["nominal_magnitude"]) == (6, 4)
    rv = paper["rv2fb"]
    change = np.abs(np.subtract(rv["identified_magnitude"], rv["nominal_magnitude"]))[2:5]
    assert np.abs(change - rv["deviation_magnitude"][2:5]).max() < 0.21


def test_ye_tables_fit_one_another():
    paper = papers.load("ye-2024")
    balls = np.array(paper["table_2"]["balls"])
    assert balls.shape == (4, 5) and np.all(np.abs(balls[:, 4] - 15) < 0.003)
    for experiment in ("ball_experiment", "tracker_experiment"):
        mdh = np.array(paper[experiment]["mdh"])
        nominal = np.array(
            [
                [np.nan, np.nan, 50, -90],
                [-90, 0, 330, 180],
                [0, 0, 35, -90],
                [0, -335, 0, 90],
                [180, 0, 0, 90],
            ]
        )
        difference = (mdh - nominal + 180) % 360 - 180
        assert np.nanmax(np.abs(difference)) < 0.8
        for method in paper[experiment]["check_mm"].values():
            assert math.isclose(
                method["rms"] ** 2, method["mean"] ** 2 + method["std"] ** 2, rel_tol=0.1
            )


def test_liu_means_are_the_means_of_their_intersections():
    table = papers.load("liu-2014")["table_2"]
    np.testing.assert_allclose(
        np.mean(table["intersections_mm"], axis=1), table["means_mm"], atol=2e-6
    )


def test_mathematics_partial_poses_see_what_they_can():
    """The x axis leaves alpha6 where it was, the y axis finds it; all else agrees with full poses."""
    paper = papers.load("mathematics-2023")
    full, x_axis, y_axis = (np.array(paper[f"table_{k}"]["deviation"]) for k in (3, 4, 5))
    assert abs(x_axis[5, 3]) < 1e-12 < 1e-4 < abs(y_axis[5, 3])
    others = np.ones_like(full, bool)
    others[4:] = False
    assert (
        np.abs((full - x_axis)[others]).max() < 3e-3
        and np.abs((full - y_axis)[others]).max() < 5e-3
    )
