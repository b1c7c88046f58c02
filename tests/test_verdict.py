"""The verdict: a residual against the noise and against `--tolerance`."""

import pytest

from workbench.core.errors import InputError
from workbench.fitting.verdicts.verdict import (
    DIAGNOSE,
    REPLICATES,
    Noise,
    Residual,
    Tolerance,
    combine,
    is_far_above,
    judge,
    no_verdict,
    parse_tolerances,
)


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        ((), ()),
        (None, ()),
        (("0.1",), (Tolerance(0.1, "mm"),)),
        (("0.1mm",), (Tolerance(0.1, "mm"),)),
        (("1e-2 mm", ".05deg"), (Tolerance(0.01, "mm"), Tolerance(0.05, "deg"))),
    ],
)
def test_tolerances_are_read_with_and_without_unit(texts, expected):
    assert parse_tolerances(texts, ("mm", "deg")) == expected


def test_the_first_unit_is_that_of_a_bare_number():
    assert parse_tolerances(["0.3"], ("px",)) == (Tolerance(0.3, "px"),)


@pytest.mark.parametrize(
    "text", ["", "mm", "0", "-1", "nan", "inf", "1e999", "0.1,2", "0.1 m", "0.3px", "1mm2", "0x1"]
)
def test_a_bad_tolerance_is_refused_in_one_sentence(text):
    with pytest.raises(InputError, match="--tolerance") as error:
        parse_tolerances([text], ("mm", "deg"))
    assert "\n" not in str(error.value)


def test_one_tolerance_per_unit():
    with pytest.raises(InputError, match="a second one in mm"):
        parse_tolerances(["0.1", "0.2mm"])


def test_only_a_tolerance_makes_a_result_pass_or_fail():
    assert judge(Residual(5.0), Noise(0.01)).passed is None
    assert judge(Residual(0.09), None, parse_tolerances(["0.1"])).passed is True
    assert judge(Residual(0.11), Noise(1.0), parse_tolerances(["0.1"])).passed is False
    assert judge(Residual(float("nan")), None, parse_tolerances(["0.1"])).passed is False


def test_a_tolerance_in_another_unit_does_not_apply():
    assert judge(Residual(5.0, "deg"), None, (Tolerance(0.1, "mm"),)).passed is None


def test_a_residual_far_above_the_noise_says_the_factor_and_what_to_do():
    verdict = judge(Residual(0.306, degrees=500), Noise(0.002))
    assert verdict.residual_over_noise == pytest.approx(153)
    assert "153 times" in verdict.sentence
    assert DIAGNOSE in verdict.sentence
    assert "stated" in verdict.sentence


def test_a_residual_at_the_noise_is_said_to_agree():
    verdict = judge(Residual(0.0102, degrees=500), Noise(0.01, REPLICATES))
    assert "agrees with the noise of 0.01 mm (from replicates)" in verdict.sentence
    assert DIAGNOSE not in verdict.sentence


@pytest.mark.parametrize(
    ("ratio", "degrees", "far"),
    [
        (1.5, 10, False),
        (1.5, 100, True),
        (1.05, 1e6, False),
        (1.2, 1e4, True),
        (1.9, None, False),
        (2.1, None, True),
    ],
)
def test_far_is_a_statement_with_degrees_of_freedom(ratio, degrees, far):
    assert is_far_above(ratio, degrees) is far


def test_without_noise_the_sentence_says_so():
    verdict = judge(Residual(0.1))
    assert verdict.residual_over_noise is None
    assert verdict.sentence.endswith(
        "the noise is unknown (not stated, and too few repeated measurements), so that 0.1 mm cannot be compared with it."
    )


def test_two_quantities_share_one_sentence_on_unknown_noise():
    both = combine([judge(Residual(0.1)), judge(Residual(0.2, "deg"))])
    assert both.sentence == (
        "RMS residual 0.1 mm. RMS residual 0.2 deg. The noise is unknown (not stated, and too few repeated "
        "measurements), so that these values cannot be compared with it."
    )
    assert all("the noise is unknown" in part.sentence for part in both.parts)


def test_position_and_orientation_pass_only_together():
    limits = parse_tolerances(["0.1mm", "0.05deg"], ("mm", "deg"))
    position = judge(Residual(0.02), Noise(0.02), limits)
    turned = judge(Residual(0.2, "deg", "held-out RMS orientation error"), None, limits)
    both = combine([position, turned])
    assert (both.passed, both.unit, both.tolerance) == (False, "deg", 0.05)
    assert position.sentence in both.sentence and turned.sentence in both.sentence
    made = both.as_json()
    assert [one["pass"] for one in made["checks"]] == [True, False]
    assert {"pass", "tolerance", "unit", "residual_over_noise", "sentence"} <= set(made)


def test_no_verdict_is_null():
    made = no_verdict("A simulation has no residual.").as_json()
    assert (
        made["pass"] is None and made["tolerance"] is None and made["residual_over_noise"] is None
    )


def test_a_noise_in_another_unit_is_not_compared():
    made = judge(Residual(0.11, "mm", "held-out RMS position error", 100), Noise(4.3e-5, "stated"))
    assert "cannot be that of this recording" in made.sentence
    assert (
        "correct the unit of the noise first" in made.sentence and "unmodelled" not in made.sentence
    )
    usual = judge(Residual(0.11, "mm", "held-out RMS position error", 100), Noise(0.01, "stated"))
    assert "cannot be that" not in usual.sentence


def test_errors_of_one_number_for_each_sample_are_named():
    from workbench.fitting.verdicts.calibration_verdict import remark_on_kind

    assert "RMS distance of these points from the ball" in remark_on_kind("ball-surface")
    assert "distances of the tip from the plane" in remark_on_kind("plane-touch")
    assert remark_on_kind("external-point") == remark_on_kind("external-pose") == ""
