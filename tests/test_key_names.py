"""Misspelt keys and synonyms of the field: the key that was probably meant."""

import pytest

from workbench.core.text.key_names import closest_key

JOINT = (
    "theta_deg",
    "alpha_deg",
    "kind",
    "limits_deg",
    "limits_mm",
    "sign",
    "coupled",
    "gear_ratio",
    "mass_kg",
    "com_mm",
)


@pytest.mark.parametrize(
    "name, meant",
    [
        ("centre_mm", "com_mm"),
        ("center_of_mass_mm", "com_mm"),
        ("cog_mm", "com_mm"),
        ("mass", "mass_kg"),
        ("weight_kg", "mass_kg"),
        ("type", "kind"),
        ("range_mm", "limits_mm"),
        ("theta_rad", "theta_deg"),
        ("alfa_deg", "alpha_deg"),
        ("sing", "sign"),
        ("colour", None),
        ("note", None),
    ],
)
def test_the_key_that_was_meant(name, meant):
    assert closest_key(name, JOINT) == meant


def test_a_synonym_is_found_from_either_side():
    assert closest_key("com_mm", ["note", "centre_mm"]) == "centre_mm"


def test_a_similar_spelling_is_no_match_where_more_similarity_is_asked_for():
    assert closest_key("alfa_deg", JOINT, similarity=0.9) is None
