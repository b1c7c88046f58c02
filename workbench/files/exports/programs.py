"""Corrected joint targets as a robot program: URScript, KUKA KRL, ABB RAPID; and read back.

Every target becomes a joint motion to a stop: the correction is in the joint readings, which no controller converts
again. Speeds are low and stand at the top of the program.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from robot_model.robot import Robot
from robot_model.state import sliding
from workbench.core.errors import InputError

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,23}")
_HEAD = "Corrected targets of {arm}; held-out RMS position error of the calibration {error:.4g} mm."
_CHECK = "Check the program at reduced speed: the correction changes every joint."


@dataclass(frozen=True)
class Program:
    """`readings` (n, R) rad, mm of a slide; `name` of the program; `arm` and `held_out_mm` for its head."""

    readings: np.ndarray
    name: str
    arm: str
    held_out_mm: float

    @property
    def remarks(self) -> tuple[str, str]:
        """Lines of the head."""
        return _HEAD.format(arm=self.arm, error=self.held_out_mm), _CHECK


def program_text(program: Program, language: str, robot: Robot) -> str:
    """The text of a program in one of `LANGUAGES`. Raises InputError where the language cannot move this arm."""
    if not _NAME.fullmatch(program.name):
        raise InputError(
            f"--out {program.name}: expected a file name that is a program name (a letter, then letters, digits and _, "
            "24 at most), found another; rename it"
        )
    count = program.readings.shape[1]
    if count != 6 or sliding(robot).any():
        raise InputError(
            f"--to {language}: expected an arm with six joints that turn, found {count} readings"
            f"{', some of slides' if sliding(robot).any() else ''}; take corrected.csv of `workbench compensate`"
        )
    if not np.isfinite(program.readings).all():
        raise InputError(
            f"--to {language}: expected joint readings for every target, found some without; correct the targets"
        )
    return LANGUAGES[language][0](program)


def read_program(text: str, language: str) -> np.ndarray:
    """(n, 6) rad: the joint targets of a program."""
    pattern, unit = LANGUAGES[language][1]
    rows = [
        [float(word) for word in re.findall(_NUMBER, line)] for line in re.findall(pattern, text)
    ]
    readings = np.array([row[:6] for row in rows]).reshape(-1, 6)
    return np.deg2rad(readings) if unit == "deg" else readings


_NUMBER = r"-?\d+\.\d+"


def _urscript(program: Program) -> str:
    lines = [f"  # {line}" for line in program.remarks]
    lines += ["  v = 0.5  # rad/s", "  a = 0.5  # rad/s^2"]
    for row in program.readings:
        lines.append(f"  movej([{_joined(row, 9)}], a=a, v=v)")
    return "\n".join([f"def {program.name}():", *lines, "end", ""])


def _krl(program: Program) -> str:
    head = ["&ACCESS RVP", f"DEF {program.name}()"]
    head += [f"; {line}" for line in program.remarks]
    head += ["BAS(#INITMOV, 0)", "BAS(#VEL_PTP, 10)", "BAS(#ACC_PTP, 10)"]
    moves = []
    for row in np.rad2deg(program.readings):
        axes = ", ".join(f"A{k} {value:.7f}" for k, value in enumerate(row, 1))
        moves.append(f"PTP {{AXIS: {axes}}}")
    return "\n".join([*head, *moves, "END", ""])


def _rapid(program: Program) -> str:
    head = [f"MODULE {program.name}"]
    head += [f"  ! {line}" for line in program.remarks]
    external = "[9E9, 9E9, 9E9, 9E9, 9E9, 9E9]"
    targets, moves = [], []
    for k, row in enumerate(np.rad2deg(program.readings), 1):
        targets.append(f"  CONST jointtarget target{k} := [[{_joined(row, 7)}], {external}];")
        moves.append(f"    MoveAbsJ target{k}, v100, fine, tool0;")
    body = ["", "  PROC main()", *moves, "  ENDPROC", "ENDMODULE", ""]
    return "\n".join([*head, *targets, *body])


def _joined(row: Sequence[float], digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in row)


LANGUAGES: dict[str, tuple[Callable[[Program], str], tuple[str, str]]] = {
    "urscript": (_urscript, (r"movej\(\[(.*?)\]", "rad")),
    "krl": (_krl, (r"PTP \{AXIS: (.*?)\}", "deg")),
    "rapid": (_rapid, (r"jointtarget \w+ := \[\[(.*?)\]", "deg")),
}
"""Name of a language -> how it is written, and the pattern and unit of its targets."""
