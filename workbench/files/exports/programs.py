"""Corrected joint targets as a robot program: URScript, KUKA KRL, ABB RAPID; and read back.

Every target becomes a joint motion to a stop: the correction is in the joint readings, which no controller converts
again. Speeds are low and stand at the top of the program. Linear axes, such as a track under the arm, are external axes
of the controller: E1 ... E6 (KRL), eax_a ... eax_f (RAPID), in mm.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from workbench.core.errors import InputError

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,23}")
_AXES, _MOST_EXTERNAL = 6, 6
HEAD_START = "Corrected targets of"
"""Begins the head of each program, by which corrected targets are recognised."""
_HEAD = HEAD_START + " {arm}; held-out RMS position error of the calibration {error:.4g} mm."
_CHECK = "Check the program at reduced speed: the correction changes every joint."


@dataclass(frozen=True)
class Program:
    """`readings` (n, R) rad, mm of a slide; `name` of the program; `arm` and `held_out_mm` for its head.

    `slides`: of each reading, whether it is one of a linear axis; () where none is.
    """

    readings: np.ndarray
    name: str
    arm: str
    held_out_mm: float
    slides: tuple[bool, ...] = ()

    @property
    def axes_deg(self) -> np.ndarray:
        """(n, 6) deg: the axes that turn."""
        return np.rad2deg(self.readings[:, ~self._is_slide])

    @property
    def external_mm(self) -> np.ndarray:
        """(n, E) mm: the linear axes."""
        return self.readings[:, self._is_slide]

    @property
    def _is_slide(self) -> np.ndarray:
        return np.array(self.slides or (False,) * self.readings.shape[1])

    @property
    def remarks(self) -> tuple[str, str]:
        """Lines of the head."""
        return _HEAD.format(arm=self.arm, error=self.held_out_mm), _CHECK


def program_text(program: Program, language: str) -> str:
    """The text of a program in one of `LANGUAGES`. Raises InputError where the language cannot move this arm."""
    if not _NAME.fullmatch(program.name):
        raise InputError(
            f"--out {program.name}: expected a file name that is a program name (a letter, then letters, digits and _, "
            "24 at most), found another; rename it"
        )
    revolute = program.axes_deg.shape[1]
    slides = program.external_mm.shape[1]
    if revolute != _AXES or slides > _MOST_EXTERNAL:
        raise InputError(
            f"--to {language}: expected an arm with six revolute joints and at most six linear axes, found {revolute} "
            f"and {slides}; use corrected.csv of `workbench compensate`"
        )
    if slides and language == "urscript":
        raise InputError(
            "--to urscript: expected an arm without linear axes, found one: movej moves the six joints of the arm only "
            "and a program of its own the linear axis; take corrected.csv of `workbench compensate`, which has the "
            "readings of both"
        )
    if not np.isfinite(program.readings).all():
        raise InputError(
            f"--to {language}: expected joint readings for every target, found some without; correct the targets"
        )
    return LANGUAGES[language][0](program)


def read_program(text: str, language: str, slides: Sequence[bool] = ()) -> np.ndarray:
    """(n, R) rad, mm of a linear axis: the joint targets of a program; slides: as in `Program`."""
    pattern, unit = LANGUAGES[language][1]
    rows = [
        [float(word) for word in re.findall(_NUMBER, line)] for line in re.findall(pattern, text)
    ]
    is_slide = np.array(slides or (False,) * _AXES)
    found = np.array(rows).reshape(-1, len(is_slide))
    readings = np.empty_like(found)
    axes = found[:, :_AXES]
    if unit == "deg":
        readings[:, ~is_slide] = np.deg2rad(axes)
    else:
        readings[:, ~is_slide] = axes
    readings[:, is_slide] = found[:, _AXES:]
    return readings


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
    kind = "E6AXIS" if any(program.slides) else "AXIS"
    for revolute, external in zip(program.axes_deg, program.external_mm):
        axes = [f"A{k} {value:.7f}" for k, value in enumerate(revolute, 1)]
        axes += [f"E{k} {value:.9f}" for k, value in enumerate(external, 1)]
        moves.append(f"PTP {{{kind}: {', '.join(axes)}}}")
    return "\n".join([*head, *moves, "END", ""])


def _rapid(program: Program) -> str:
    head = [f"MODULE {program.name}"]
    head += [f"  ! {line}" for line in program.remarks]
    targets, moves = [], []
    for k, (revolute, slides) in enumerate(zip(program.axes_deg, program.external_mm), 1):
        used = [f"{value:.9f}" for value in slides]
        external = ", ".join([*used, *["9E9"] * (_MOST_EXTERNAL - len(used))])
        targets.append(
            f"  CONST jointtarget target{k} := [[{_joined(revolute, 7)}], [{external}]];"
        )
        moves.append(f"    MoveAbsJ target{k}, v100, fine, tool0;")
    body = ["", "  PROC main()", *moves, "  ENDPROC", "ENDMODULE", ""]
    return "\n".join([*head, *targets, *body])


def _joined(row: Sequence[float], digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in row)


LANGUAGES: dict[str, tuple[Callable[[Program], str], tuple[str, str]]] = {
    "urscript": (_urscript, (r"movej\(\[(.*?)\]", "rad")),
    "krl": (_krl, (r"PTP \{(?:E6)?AXIS: (.*?)\}", "deg")),
    "rapid": (_rapid, (r"jointtarget \w+ := \[(\[.*?\], \[.*?\])\]", "deg")),
}
"""Name of a language -> how it is written, and the pattern and unit of its targets."""
