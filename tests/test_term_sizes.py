"""Sizes of the terms of a calibrated model: each term is listed with what it changes beyond base and tool."""

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from scenes import model_of, scene
from workbench.files.solution_file import name_of
from workbench.files.term_sizes import term_sizes

EFFECTS = (
    ("transmission-harmonic", "joint-2", {"order": 2}),
    ("transmission-harmonic", "joint-3", {"order": 1}),
    ("joint-compliance", "joint-2", {}),
    ("base-drift", "base", {"start": 0.0, "end": 600.0}),
)


def test_terms_are_listed_by_size_and_those_at_zero_are_not():
    keys = model_of(scene("external-point", n=80, seed=3), *EFFECTS).parameters.keys
    large = next(k for k in keys if k.startswith("joint-2.") and k.endswith("sin2"))
    small = next(k for k in keys if k.startswith("joint-3.") and k.endswith("sin1"))
    model = model_of(scene("external-point", n=80, seed=3), *EFFECTS)
    rows = term_sizes(model, model.parameters.update({large: 1e-3, small: 1e-4}), name_of)
    assert [(row["name"], row["order"]) for row in rows] == [
        ("joint-2.transmission-harmonic", 2),
        ("joint-3.transmission-harmonic", 1),
    ]
    # 1 mrad times a sine of RMS 0.7, at levers of some 400 mm
    assert 0.05 < rows[0]["rms_mm"] < 0.5
    assert rows[1]["rms_mm"] < 0.5 * rows[0]["rms_mm"]


def test_what_base_and_tool_absorb_is_no_size():
    """A rotation of joint 1 by one angle is one of the base."""
    made = scene("external-point", n=80, seed=3)
    model = model_of(made, ("zero-shift", "joint-1", {"after": -1.0}))
    (key,) = [k for k in model.parameters.keys if "zero-shift" in k]
    rows = term_sizes(model, model.parameters.update({key: 1e-4}), name_of)
    assert not rows or rows[0]["rms_mm"] == pytest.approx(0.0, abs=1e-3)
    assert name_of(model.effects[0]) in CATALOGUE
    change = model.residual(model.parameters.update({key: 1e-4})) - model.residual(model.parameters)
    assert np.sqrt((change**2).sum(0).mean()) > 0.02
