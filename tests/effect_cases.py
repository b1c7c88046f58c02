"""One case for each robot effect, with the sizes of its parameters, and the models to test them in."""

from dataclasses import replace

import pytest

from robot_model.effects import CATALOGUE
from scenes import ABB, SLIDING, model_of, scene
from workbench.core.model import STATE_PORTS

# the robot's, sensor's and data rows of spec/effects.md
VOCABULARY = {
    "transmission-harmonic",
    "joint-compliance",
    "link-self-weight",
    "link-compliance",
    "backlash",
    "joint-coupling",
    "zero-shift",
    "encoder-quantisation",
    "link-thermal-growth",
    "joint-thermal-drift",
    "pedestal-compliance",
    "base-drift",
    "mount-tilt",
    "tool-deflection",
    "time-offset",
    "axis-run-out",
    "range-scale",
    "field-bias",
    "incidence-bias",
    "subsurface-scatter",
    "lens-residual",
    "camera-thermal-drift",
    "window-refraction",
    "plane-bow",
    "mirror-wobble",
    "mirror-encoder-harmonic",
    "mirror-hysteresis",
    "frame-sync",
    "board-bow",
    "ball-position",
    "ball-radius",
    "artefact-expansion",
    "outliers",
    "noise-heteroscedastic",
    "unit-or-frame",
    "unknown",
}


# Beyond it: masses that are not where the data sheet says, bearings that tilt, Ye's constant Fourier term, tilts
# that an accelerometer has recorded, readings taken while the arm still brakes, screws and racks,
# a load whose centre is elsewhere.
ADDITIONS = {
    "first-moment",
    "bearing-compliance",
    "zero-offset",
    "measured-tilt",
    "reading-lag",
    "cyclic-lead-error",
    "payload-centre",
    "sensor-thermal-growth",
    "range-offset",
    "lateral-scale",
}


# Of the scanner: laws of recorded time, mirror speed and any other column, lines of a board, and the line's profile.
SCANNER_ADDITIONS = {
    "laser-drift",
    "mirror-vibration",
    "rolling-shutter",
    "recorded-column",
    "board-point-errors",
    "ball-form",
    "focus-breathing",
    "blooming",
    "ghost-line",
    "lateral-scale",
}


VARIANTS = (
    "ye-compliance",
    "mount-tilt-torsion",
    "gravity-bearing-compliance",
    "gravity-link-compliance",
    "gravity-pedestal-compliance",
    "link-beam",
    "load-deflection",
    "link-warm-up",
    "base-warm-up",
    "instrument-range-scale",
    "target-shift",
)


PORT_SIZES = {
    "joint": 6,
    "geometry": 30,
    "frame": 48,
    "gravity": 3,
    "mass": 22,
    "sensor": 3,
    "target": 3,
    "noise": 1,
}


MIXTURE = [[[10.0 * k, -5.0, 3.0 * k] for k in range(7)]]


CASES = (
    (
        "smooth-function",
        "joint-3",
        {"port": "joint", "names": ["q3"], "spans": [[-1.5, 1.5]], "unit": "rad", "sizes": [3e-4]},
    ),
    (
        "smooth-function",
        "link-2",
        {
            "port": "frame",
            "names": ["q2", "tau3"],
            "spans": [[-1.5, 1.5], [-20.0, 20.0]],
            "unit": "mm and rad",
            "sizes": [0.05, 0.05, 0.05, 3e-4, 3e-4, 3e-4],
        },
    ),
    (
        "periodic-motion",
        "base",
        {
            "rate": 0.03,
            "units": ["mm", "mm", "mm", "rad", "rad", "rad"],
            "sizes": [0.05, 0.05, 0.05, 3e-4, 3e-4, 3e-4],
        },
    ),
    (
        "compliance-with-masses",
        "joint-2",
        {"law": "joint-compliance", "mixtures": MIXTURE, "shares": [[0.3]]},
    ),
    (
        "compliance-with-masses",
        "base",
        {"law": "pedestal-compliance", "mixtures": MIXTURE, "shares": [[0.3, 0.1]]},
    ),
    ("transmission-harmonic", "joint-2", {"order": 1}),
    ("transmission-harmonic", "joint-5", {"order": 80}),
    ("cyclic-lead-error", "joint-2", {"period": 16.0}),
    ("zero-offset", "joint-3", {}),
    ("backlash", "joint-3", {}),
    ("backlash", "joint-3", {"seat": "gravity"}),
    ("backlash", "joint-4", {"seat": "moves"}),
    ("zero-shift", "joint-1", {"after": 200.0}),
    ("joint-coupling", "joint-6", {"joint": 5}),
    ("joint-thermal-drift", "joint-2", {}),
    ("time-offset", "time", {}),
    ("reading-lag", "time", {}),
    ("reading-lag", "time", {"law": "share"}),
    ("joint-curve", "joint-4", {"start": -2.0, "end": 2.0, "terms": 5}),
    ("joint-compliance", "joint-2", {}),
    ("gravity-compliance", "joint-2", {}),
    ("gravity-compliance", "joint-5", {}),
    ("gravity-bearing-compliance", "joint-1", {}),
    ("gravity-link-compliance", "link-2", {}),
    ("gravity-pedestal-compliance", "base", {}),
    ("link-beam", "link-2", {}),
    ("payload", "tool", {}),
    ("payload", "tool", {"after": 200.0}),
    ("payload-centre", "tool", {}),
    ("load-deflection", "tool", {"after": 200.0}),
    ("shift", "tool", {"after": 200.0}),
    ("shift", "base", {"after": 200.0}),
    ("shift", "link-2", {"after": 200.0}),
    ("target-shift", "ball-2", {"after": 200.0}),
    ("loosening", "tool", {"start": 0.0, "end": 500.0}),
    ("warm-up", "joint-2", {"time_constant": 100.0}),
    ("link-warm-up", "link-2", {"time_constant": 100.0}),
    ("base-warm-up", "base", {"time_constant": 100.0}),
    ("joint-hysteresis", "joint-3", {}),
    ("joint-hysteresis", "joint-3", {"width": 0.1, "law": "dahl"}),
    ("joint-torque", "joint-3", {"start": -2.0, "end": 2.0}),
    ("reading-lattice", "joint-3", {"step": 0.001}),
    ("sight-line-refraction", "instrument", {}),
    ("azimuth-harmonic", "instrument", {"order": 5.0}),
    ("elevation-harmonic", "instrument", {"order": 3.0}),
    ("instrument-range-scale", "instrument", {}),
    ("range-offset", "instrument", {}),
    ("reflector-incidence", "tool", {}),
    ("angular-noise", "noise", {}),
    ("link-self-weight", "joint-3", {}),
    ("ye-compliance", "joint-1", {}),
    ("link-compliance", "link-2", {}),
    ("bearing-compliance", "joint-1", {}),
    ("bearing-compliance", "joint-6", {}),
    ("pedestal-compliance", "base", {}),
    ("tool-deflection", "tool", {}),
    ("mount-tilt", "base", {}),
    ("mount-tilt-torsion", "base", {}),
    ("first-moment", "link-3", {}),
    ("first-moment", "tool", {}),
    ("link-thermal-growth", "link-2", {}),
    ("base-drift", "base", {"start": 0.0, "end": 500.0, "order": 2}),
    ("axis-run-out", "joint-1", {}),
    ("axis-run-out", "joint-4", {}),
    ("measured-tilt", "base", {"sensor": "foot"}),
    ("measured-tilt", "link-2", {"sensor": "foot", "axes": "xz"}),
    ("range-scale", "sensor", {"z0": 250.0}),
    ("lateral-scale", "sensor", {}),
    ("lateral-scale", "sensor", {"axis": "y"}),
    ("sensor-thermal-growth", "sensor", {}),
    ("field-bias", "sensor", {}),
    ("ball-position", "ball-2", {}),
    ("artefact-expansion", "artefact", {}),
    ("noise-heteroscedastic", "noise", {"covariate": "range_mm", "mean": 250.0, "spread": 30.0}),
)


EVERY = pytest.mark.parametrize(
    "case",
    CASES,
    ids=lambda case: "-".join(str(part) for part in (case[0], case[1], *case[2].values())),
)


POINTS = pytest.mark.parametrize("measures", ["ball-centre", "external-point"])


# what lets gravity and masses be seen
SOFT = (
    ("joint-compliance", "joint-2", {}),
    ("link-compliance", "link-3", {}),
    ("ye-compliance", "joint-4", {}),
    ("tool-deflection", "tool", {}),
)


MISSING = {
    ("backlash", "joint-3"): ("approach3", {}),
    ("time-offset", "time"): ("qdot1_deg_s", {}),
    ("measured-tilt", "base"): ("accel_foot_x_m_s2", {"sensor": "foot"}),
    ("measured-tilt", "link-2"): ("accel_foot_z_m_s2", {"sensor": "foot", "axes": "xz"}),
    ("noise-heteroscedastic", "noise"): ("range_mm", {"covariate": "range_mm"}),
}


OF_SLIDES = ("cyclic-lead-error",)
"""Effects of prismatic joints, which are tested at an arm that has some."""


def with_effect(case, measures="external-point", arm=ABB, n=40):
    """The model with the case's effect first, and behind it what lets it be seen."""
    made = scene(measures, n=n, arm=SLIDING if case[0] in OF_SLIDES else arm, seed=3)
    needed = (
        [soft for soft in SOFT if soft[:2] != case[:2]]
        if CATALOGUE[case[0]].port in STATE_PORTS
        else []
    )
    return model_of(made, case, *needed)


def own_part(model):
    return model.spans[0]


def started(model, sizes):
    """Parameters at their start; the effects' set to `sizes` typical sizes."""
    start = model.parameters
    values = start.values.copy()
    begin = len(model.chain.parameters)
    values[begin:] = (start.typical * sizes)[begin:]
    return replace(start, values=values)


def state_of(model):
    return model.chain.state
