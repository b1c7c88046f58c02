"""Writes docs/effects.md from the catalogue, so that no effect is described in two places.

`python tools/effects_page.py` writes the page; `--check` says whether it is up to date (status 1).
"""

import sys
from pathlib import Path

from robot_model.effects import CATALOGUE as ROBOT
from sensors.effects import CATALOGUE as SENSOR
from sensors.scanner.turntable import ANGLE_ERRORS
from workbench.core.effect import Effect

PAGE = Path(__file__).parents[1] / "docs" / "effects.md"
HEAD = """# Catalogue of effects

This page lists every physical effect that a model can contain, with its law (equation), its places, its port and
its source. A plan or a scene names an effect by the first column. The second column is the name in the answer of a
diagnosis: several variants of an effect share it. `python tools/effects_page.py` generates this page from the
classes of the effects.

![Effects of arm and scanner under the ports that they change](images/effects.png)

## Conventions

- **Frames.** Frame 0 is the base frame of the robot (of a URDF, or with `[base]` in the robot file: the frame on its
  first axis). Frame K follows the complete row K of the robot file, in the standard convention as in the modified
  one. J is the number of joints.
- **Joint variable** q_K, in rad (mm for a prismatic joint): sign and coupling of the robot file are applied to the
  readings; the offset theta is not added. A change dq is added to it, at the port `joint`.
- **Gravity torque** tau_K, in N m: torque of the bodies K to J and the load about the axis of joint K, at the nominal
  geometry. It is positive if gravity drives the joint towards larger q_K. For a prismatic joint it is a force in N.
- **Load.** The mass of the tool (`[payload]` of the robot file) plus the column `payload_kg`, both at the centre of
  mass of the tool. If the tool has no mass, the load is at the measured point.
- **Port `frame`.** A small motion (twist: translation in mm, then rotation vector in rad) in the axes of its place
  moves all parts between this place and the flange. The pivot of the rotation is: of `base` the origin of the base
  frame; of `link-K` the middle of the link, with the axes of frame K; of `tool` the origin of the flange frame. A link
  runs along its joint's axis from the foot of the common normal with the axis before, and along the common normal with
  the next axis up to that axis (the last link: to the flange). These points move with the link, in either convention.
- **Gravity** is a direction in the base frame (of a URDF: in the frame of its root link). Moments M are in N m.
- **Time** is `time_s`, or the row number if no time is recorded. **T - T0** is the temperature above 20 °C,
  or the time in hours if no temperature is recorded.

## Effects of the arm and the instrument (`robot_model/effects/`)

"""
SENSOR_HEAD = """
## Effects of the scanner (`sensors/effects/`)

The renderer, the calibration and the diagnosis use the same definitions.

"""
TURNTABLE_HEAD = """
## Effects of the turntable (`sensors/scanner/turntable.py`)

A turntable rotates the object in front of a fixed scanner: theta is the commanded angle, phi = theta + dphi the
actual one. `workbench scanner` estimates these effects together with the axis of the table, and `workbench
diagnose` reports those that its tests retain. A plan cannot name them. [Scanners](how-to/scanners.md#turntable)
describes a recording.

"""
TURNTABLE_COLUMNS = """| name | law | source | what it is | tested by the diagnosis |
|---|---|---|---|---|
"""
COLUMNS = """| name | effect | place | port | law | source | what it is | tested by the diagnosis |
|---|---|---|---|---|---|---|---|
"""


def page() -> str:
    """The whole page."""
    return HEAD + _table(ROBOT) + SENSOR_HEAD + _table(SENSOR) + TURNTABLE_HEAD + _turntable()


def _turntable() -> str:
    rows = [
        (f"`{one.name}`", f"`{one.law}`", one.source, one.description, one.tested)
        for one in ANGLE_ERRORS
    ]
    return TURNTABLE_COLUMNS + "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _table(catalogue) -> str:
    return COLUMNS + "".join(_row(name, kind) for name, kind in catalogue.items())


def _row(name, kind) -> str:
    what = " ".join((kind.__doc__ or "").split("\n\n")[0].split())
    cells = (
        f"`{name}`",
        kind.effect,
        ", ".join(kind.places),
        kind.port,
        f"`{kind.equation}`",
        kind.source,
        what,
        _tested(kind),
    )
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def _tested(kind) -> str:
    """Text on the variants that the diagnosis tests, from the docstrings of the effect."""
    sentences = [_own_text(kind, name) for name in ("candidates", "grids")]
    if sentences[1] and sentences[0].startswith("None"):
        sentences[0] = ""
    if not any(sentences):
        needs = kind.needs if isinstance(kind.needs, tuple) else ()
        sentences = [f"Where {' and '.join(needs)} varies." if needs else "At every place."]
    if kind.needs_compliance:
        sentences.append("Only where the model contains a compliance.")
    return " ".join(filter(None, sentences))


def _own_text(kind, method: str) -> str:
    """The docstring of a method of an effect's class or of what it shares with others; "" for that of `Effect`."""
    classes = kind.__mro__[: kind.__mro__.index(Effect)]
    own = next((vars(some)[method] for some in classes if method in vars(some)), None)
    return " ".join(own.__doc__.split()) if own else ""


def main() -> int:
    """Write or check; the exit status."""
    if "--check" not in sys.argv:
        PAGE.write_text(page(), encoding="utf-8")
        return 0
    fresh = PAGE.is_file() and PAGE.read_text(encoding="utf-8") == page()
    print(
        "docs/effects.md is up to date"
        if fresh
        else "docs/effects.md is stale: run python tools/effects_page.py"
    )
    return 0 if fresh else 1


if __name__ == "__main__":
    sys.exit(main())
