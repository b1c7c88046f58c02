"""The effects of the vocabulary, their requirements on the world, and their weights in the draw."""

from collections.abc import Callable
from dataclasses import dataclass

from datasets.makers.blind.effects import bodies, data, joints
from datasets.makers.blind.workplace import Requirements


@dataclass(frozen=True)
class Row:
    """law: makes the effect. requirements: on the scene. weight: of the draw. one_sided: its size is positive."""

    law: Callable
    requirements: Requirements = Requirements()
    weight: float = 1.0
    one_sided: bool = False


_BALLS = "ball-centre"


def _needs(*kinds: str, **requirements) -> Requirements:
    return Requirements(need=frozenset(kinds), **requirements)


ROWS = {
    "transmission-harmonic": Row(joints.transmission_harmonic, weight=3.0),
    "joint-compliance": Row(bodies.joint_compliance, weight=2.0, one_sided=True),
    "link-self-weight": Row(bodies.link_self_weight, _needs("payload"), one_sided=True),
    "link-compliance": Row(bodies.link_compliance, weight=1.5, one_sided=True),
    "backlash": Row(joints.backlash, _needs("approach"), weight=1.5),
    "backlash-by-gravity": Row(joints.backlash_by_gravity),
    "joint-coupling": Row(joints.joint_coupling, weight=1.5),
    "zero-shift": Row(joints.zero_shift, weight=1.5),
    "encoder-quantisation": Row(joints.encoder_quantisation, weight=0.5, one_sided=True),
    "link-thermal-growth": Row(
        joints.link_thermal_growth, _needs("temperature"), weight=1.5, one_sided=True
    ),
    "joint-thermal-drift": Row(joints.joint_thermal_drift, _needs("temperature"), weight=1.5),
    "pedestal-compliance": Row(bodies.pedestal_compliance, one_sided=True),
    "base-drift": Row(bodies.base_drift, _needs("time"), weight=1.5),
    "mount-tilt": Row(bodies.mount_tilt, Requirements(elastic=True), weight=0.5, one_sided=True),
    "tool-deflection": Row(bodies.tool_deflection, one_sided=True),
    "time-offset": Row(joints.time_offset, _needs("speed")),
    "reading-lag": Row(joints.reading_lag, one_sided=True),
    "axis-run-out": Row(bodies.axis_run_out, weight=1.5),
    "range-scale": Row(bodies.range_scale, Requirements(_BALLS)),
    "field-bias": Row(bodies.field_bias, Requirements(_BALLS)),
    "ball-position": Row(bodies.ball_position, Requirements(_BALLS)),
    "artefact-expansion": Row(
        bodies.artefact_expansion, Requirements(_BALLS, frozenset({"temperature"})), one_sided=True
    ),
    "outliers": Row(data.outliers, one_sided=True),
    "noise-heteroscedastic": Row(
        data.noise_heteroscedastic, _needs("temperature", "payload"), one_sided=True
    ),
    "unit-or-frame": Row(data.unit_or_frame, weight=0.5, one_sided=True),
}
"""What can be drawn; "backlash-by-gravity" is a backlash whose side gravity chooses."""

ABSORBED = {
    "transmission-harmonic": "workspace",
    "link-thermal-growth": "temperature",
    "joint-thermal-drift": "temperature",
    "joint-compliance": "payload",
    "link-self-weight": "workspace",
    "link-compliance": "payload",
    "pedestal-compliance": "payload",
    "range-scale": "workspace",
}
"""Effects that a fit absorbs almost completely -> the property that defines the part of the samples where they show."""

WITHHELD = {
    "backlash": ("approach", ("approach", "last motion", "last move", "came from")),
    "joint-compliance": ("payload", ("payload",)),
    "link-thermal-growth": ("temperature", ("temperature",)),
    "joint-thermal-drift": ("temperature", ("temperature",)),
    "time-offset": ("speed", ("speed", "qdot", "velocity")),
}
"""Effect -> the kind of covariate that is withheld, and words by which an answer requests it."""
