"""Fixed scoring rules of the blind benchmark: what a correct answer is where several names are correct."""

import pytest

from workbench.proving import scoring

NOISE_CLAIM = {"effect": "stated-noise", "where": "noise", "probability": 1.0}
WRONG_SIGMA = "Gaussian, wrong sigma stated"


def answer_of(verdict, *effects):
    return {"verdict": verdict, "effects": list(effects), "located": []}


def claim(effect, where):
    return {"effect": effect, "where": where, "probability": 1.0, "depends_on": ["q3"]}


def truth_of(*effects, noise="Gaussian"):
    return {"effects": list(effects), "noise": noise, "sigma_mm": 0.01}


@pytest.mark.parametrize(
    "effect, noise, outcome, is_wrong",
    [
        ("stated-noise", WRONG_SIGMA, "right", False),
        ("stated-noise", "Gaussian", "false alarm", True),
        ("noise-heavy-tailed", "heavy-tailed", "right", False),
        ("noise-heavy-tailed", WRONG_SIGMA, "false alarm", True),
    ],
)
def test_a_finding_on_the_noise_is_right_only_where_the_noise_is_such(
    effect, noise, outcome, is_wrong
):
    said = answer_of("explained", NOISE_CLAIM | {"effect": effect})
    found = scoring.score_answer(truth_of(noise=noise), said)
    assert found["outcome"] == outcome
    assert found["confidently_wrong"] is is_wrong


def test_an_effect_found_next_to_a_wrong_stated_sigma_is_still_a_false_alarm():
    said = answer_of("explained", NOISE_CLAIM, claim("backlash", "joint-2"))
    assert scoring.score_answer(truth_of(noise=WRONG_SIGMA), said)["outcome"] == "false alarm"


@pytest.mark.parametrize(
    "named, outcome",
    [(claim("joint-curve", "joint-3"), "exact"), (claim("joint-curve", "joint-4"), "wrong")],
)
def test_an_equivalent_effect_of_the_catalogue_is_correct_at_its_place(named, outcome):
    worn = {"effect": "unknown", "where": "joint-3", "accept": [["joint-curve", "joint-3"]]}
    found = scoring.score_answer(truth_of(worn), answer_of("explained", named))
    assert found["outcome"] == outcome
    assert found["confidently_wrong"] is (outcome == "wrong")
