"""Mistakes that users make in recordings, and what the plausibility check makes of them.

A `Mistake` changes a sound recording; `causes` are the terms of `Suspicion.cause` that name it rightly. Where the
mistake is absorbed by parameters that are estimated anyway, `absorbed` says by which: nothing can detect it then.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import user_error_changes as changes
from datasets.recording import Recording
from robot_model import load_robot
from workbench.core.errors import InputError
from workbench.fitting.plausibility import check_plausibility
from workbench.fitting.plausibility.fitting import fit_recording

POINT_KINDS = ("external-point", "external-pose", "partial-pose", "ball-centre")
EXTERNAL = ("external-point", "external-pose", "partial-pose")


@dataclass(frozen=True)
class Mistake:
    """`make(recording)` returns the recording with the mistake, or None where it does not apply to it."""

    name: str
    causes: tuple[str, ...]
    make: Callable[[Recording], Recording | None]
    kinds: tuple[str, ...] = POINT_KINDS
    absorbed: Callable[[Recording], str] = lambda recording: ""
    refusal: str = ""  # word of the sentence by which a reader refuses it before anything is fitted


_SIGN, _UNIT, _LENGTH = ("joint-sign",), ("joint-unit",), ("length-unit",)
_MOVED, _SHUFFLED = ("moved",), ("rows-shuffled",)
_COMPLIANCE = "absorbed by the joint compliances, which become smaller by the same factor; predicted positions are right"

MISTAKES = (
    Mistake("one joint of the opposite sign", _SIGN, changes.scaled(-1, 1)),
    Mistake("three joints of the opposite sign", _SIGN, changes.scaled(-1, 0, 1, 3)),
    Mistake("one joint in radians", _UNIT, changes.scaled(np.pi / 180, 2)),
    Mistake("two joints in radians", _UNIT, changes.scaled(np.pi / 180, 2, 3)),
    Mistake("one joint in gon", _UNIT, changes.scaled(1 / 0.9, 1)),
    Mistake("one joint in turns", _UNIT, changes.scaled(1 / 360, 1)),
    Mistake("two joint columns swapped", ("joint-order",), changes.swapped),
    Mistake("joint columns in reverse order", ("joint-order",), changes.reordered(0)),
    Mistake("joint columns moved on by one place", ("joint-order",), changes.reordered(1)),
    Mistake("one joint offset by 90 degrees", ("joint-offset", "geometry"), changes.offset),
    Mistake("one encoder stuck", ("stuck-encoder",), changes.stuck(1.0)),
    Mistake("one encoder stuck from the middle on", ("stuck-encoder",), changes.stuck(0.5)),
    Mistake("readings rounded to whole degrees", ("rounding",), changes.rounded(1.0)),
    Mistake("readings rounded to tenths of a degree", ("rounding",), changes.rounded(0.1)),
    Mistake("positions in inches", _LENGTH, changes.points(1 / 25.4)),
    Mistake("positions in cm", _LENGTH, changes.points(0.1)),
    Mistake("z in m", _LENGTH, changes.points(0.001, ("z_mm",))),
    Mistake("x in inches", _LENGTH, changes.points(1 / 25.4, ("x_mm",))),
    Mistake("left-handed frame", ("left-handed",), changes.left_handed),
    Mistake("z of the opposite sign", ("axis-sign", "left-handed"), changes.one_axis),
    Mistake("x and y swapped", ("axis-order", "left-handed"), changes.axes_swapped),
    Mistake("quaternion as x, y, z, w", ("quaternion-order",), changes.xyzw, ("external-pose",)),
    Mistake(
        "rotation matrix transposed", ("inverse-rotation",), changes.conjugate, ("external-pose",)
    ),
    Mistake("inverse pose", ("inverse-pose",), changes.inverse, ("external-pose",)),
    Mistake("measurements one row late", ("rows-shifted",), changes.late),
    Mistake("measurements in reverse order", ("rows-reversed",), changes.backwards),
    Mistake("measurements shuffled", _SHUFFLED, changes.shuffled),
    Mistake("a row missing at three quarters", ("rows-shifted",), changes.row_missing),
    Mistake("2 % blunders", ("blunders",), changes.blunders(0.02)),
    Mistake("10 % blunders", ("blunders",), changes.blunders(0.1)),
    Mistake("two balls swapped", ("ball-labels",), changes.labels_swapped, ("ball-centre",)),
    Mistake(
        "a few wrong labels",
        ("ball-labels", "reflector-labels"),
        changes.few_labels,
        ("ball-centre", "external-point"),
    ),
    Mistake(
        "artefact.csv in inches", ("artefact-unit",), changes.artefact(1 / 25.4), ("ball-centre",)
    ),
    Mistake(
        "artefact.csv left-handed",
        ("artefact-left-handed", "wrong-target"),
        changes.artefact_mirrored,
        ("ball-centre",),
    ),
    Mistake("base, instrument or artefact moved midway", _MOVED, changes.moved("base", 4.0, 0.3)),
    Mistake("instrument set up again midway", _MOVED, changes.set_up_again(700.0, 50.0), EXTERNAL),
    Mistake("target or sensor slipped midway", _MOVED, changes.moved("tool", 3.0, 0.4)),
    Mistake("file of another robot", ("robot-file",), changes.other_robot),
    Mistake("modified instead of standard convention", ("convention",), changes.convention),
    Mistake("one link length off by a quarter", ("geometry", "robot-file"), changes.link),
    Mistake("sigma 1000 times too large", ("sigma",), changes.sigma(1000)),
    Mistake("sigma in m", ("sigma",), changes.sigma(0.001)),
    Mistake("payload in g", ("payload",), changes.covariate("payload_kg", lambda v: 1000 * v)),
    Mistake("payload negative", ("payload",), changes.covariate("payload_kg", lambda v: -v)),
    Mistake(
        "payload in pounds",
        ("payload",),
        changes.covariate("payload_kg", lambda v: v / 0.4536),
        absorbed=lambda recording: _COMPLIANCE,
    ),
    Mistake(
        "temperature in Fahrenheit",
        ("temperature",),
        changes.covariate("temperature_c", lambda v: 1.8 * v + 32),
    ),
    Mistake("time in ms", ("time",), changes.covariate("time_s", lambda v: 1000 * v)),
    Mistake("too few poses", ("few-poses",), changes.few),
    Mistake(
        "a sign and x in inches",
        ("joint-sign", "length-unit"),
        changes.two(changes.scaled(-1, 2), changes.points(1 / 25.4, ("x_mm",))),
    ),
    Mistake(
        "a sign and two columns swapped",
        ("joint-sign", "joint-order"),
        changes.two(changes.swapped, changes.scaled(-1, 0)),
    ),
)
"""Every mistake of the table."""


RIGHT = ("stopped", "warned", "either")
"""Outcomes that name the right cause."""


# --- outcomes --------------------------------------------------------------------------------------------------------


def is_absorbed(sound: Recording, wrong: Recording) -> bool:
    """Whether the wrong recording fits as well as the sound one, with a geometry as plausible: nothing can tell.

    A joint that hardly moves the target in these poses, for example, may be stuck without a trace.
    """
    fits = [fit_recording(load_robot(r.robot), r) for r in (sound, wrong)]
    plausible = np.abs(fits[1].deviations).max() < np.abs(fits[0].deviations).max() + 2
    return fits[1].core < 1.25 * fits[0].core and plausible


def judged(mistake: Mistake, recording: Recording) -> str:
    """What the plausibility check makes of a recording with a mistake.

    "stopped" or "warned": with the right cause; "either": the right cause is named as an equally good explanation,
    which the data cannot tell from the first; "other cause": stopped or warned with another one; "unnamed": warned
    that nothing explains the misfit; "silent": not a word.
    """
    try:
        found = check_plausibility(load_robot(recording.robot), recording)
    except InputError as refused:
        named = mistake.refusal and mistake.refusal in str(refused)
        return "stopped" if named else "other cause"
    right = [f for f in found if set(f.cause.split(" and ")) & set(mistake.causes)]
    if right:
        return "stopped" if any(f.certain for f in right) else "warned"
    if any(set(f.alternatives) & set(mistake.causes) for f in found):
        return "either"
    if not found:
        return "silent"
    return "unnamed" if all(f.cause == "unexplained" for f in found) else "other cause"
