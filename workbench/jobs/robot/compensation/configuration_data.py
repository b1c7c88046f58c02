"""Configuration data of a position of a robot program, as its controller counts the joints.

| maker | data | meaning |
|---|---|---|
| KUKA | T | bit k - 1 is 1 where axis k is negative |
| KUKA | S | bit 0: wrist centre behind axis 1; bit 1: axis 3 beyond the stretched arm; bit 2: axis 5 negative |
| ABB | cf1, cf4, cf6 | quadrant of axes 1, 4, 6: 0 from 0 to 90 deg, -1 from -90 to 0 deg |
| ABB | cfx | sum of 4: wrist centre behind axis 1; 2: behind the lower arm; 1: axis 5 negative |
| FANUC | F, N | axis 5 positive, negative |
| FANUC | U, D | wrist centre before, behind the lower arm |
| FANUC | T, B | wrist centre before, behind axis 1 |
| FANUC | t1, t4, t6 | revolutions of axes 1, 4, 6: 0 from -180 to 180 deg, 1 from 180 to 540 deg |

Sources: KUKA System Software, status and turn of a position; ABB RAPID reference, confdata; FANUC as measured on
ROBOGUIDE, the simulation by the maker, for CrossArm (github.com, `convert/configuration.py`).
"""

import re
from dataclasses import dataclass

import numpy as np

_KUKA = re.compile(r"(?:S (?P<status>\d+))?(?:, )?(?:T (?P<turn>\d+))?")
_FANUC = re.compile(r"([FN]) ([UD]) ([TB]), (-?\d+), (-?\d+), (-?\d+)")
_JOINTS = 6
_REVOLVING = (0, 3, 5)  # axes whose quadrant or revolutions ABB and FANUC state


@dataclass(frozen=True)
class ConfigurationData:
    """`low`, `high` (6,) deg: the readings of the controller are between them.

    `sides` (3,): wrist centre behind axis 1, axis 3 beyond the stretched arm, axis 5 negative, each 1 for yes, -1 for
    no, 0 where it is not stated. `maker`: "KUKA", "ABB" or "FANUC".
    """

    maker: str
    low: np.ndarray
    high: np.ndarray
    sides: tuple[int, int, int]


def parse_configuration(text: str) -> ConfigurationData | None:
    """The data that a program states in `text`; None for text of another form."""
    kuka = _KUKA.fullmatch(text)
    if text and kuka:
        return _of_kuka(kuka["status"], kuka["turn"])
    fanuc = _FANUC.fullmatch(text)
    if fanuc:
        return _of_fanuc(*fanuc.groups())
    numbers = text.split(", ")
    if len(numbers) == 4 and all(re.fullmatch(r"-?\d+", number) for number in numbers):
        return _of_abb([int(number) for number in numbers])
    return None


def _of_kuka(status: str | None, turn: str | None) -> ConfigurationData:
    low, high = _open_limits()
    sides = (0, 0, 0)
    if status is not None:
        sides = (_side(int(status) & 1), _side(int(status) & 2), _side(int(status) & 4))
    if turn is not None:
        for k in range(_JOINTS):
            is_negative = bool(int(turn) >> k & 1)
            _set_sign(low, high, k, is_negative)
        sides = (sides[0], sides[1], _side(int(turn) & 16))
    _set_sign_of_fifth(low, high, sides[2])
    return ConfigurationData("KUKA", low, high, sides)


def _of_abb(numbers: list[int]) -> ConfigurationData:
    low, high = _open_limits()
    for k, quadrant in zip(_REVOLVING, numbers):
        low[k] = 90.0 * quadrant
        high[k] = 90.0 * (quadrant + 1)
    flags = numbers[3]
    sides = (_side(flags & 4), _side(not flags & 2), _side(flags & 1))
    _set_sign_of_fifth(low, high, sides[2])
    return ConfigurationData("ABB", low, high, sides)


def _open_limits() -> tuple[np.ndarray, np.ndarray]:
    """(6,) lowest and (6,) highest readings, deg, of joints about which nothing is stated."""
    return np.full(_JOINTS, -np.inf), np.full(_JOINTS, np.inf)


def _of_fanuc(flip: str, elbow: str, side: str, *revolutions: str) -> ConfigurationData:
    low, high = _open_limits()
    for k, count in zip(_REVOLVING, revolutions):
        middle = 360.0 * int(count)
        low[k] = middle - 180
        high[k] = middle + 180
    sides = (_side(side == "B"), _side(elbow == "D"), _side(flip == "N"))
    _set_sign_of_fifth(low, high, sides[2])
    return ConfigurationData("FANUC", low, high, sides)


def _side(is_there: int | bool) -> int:
    return 1 if is_there else -1


def _set_sign_of_fifth(low: np.ndarray, high: np.ndarray, side: int) -> None:
    if side:
        _set_sign(low, high, 4, side > 0)


def _set_sign(low: np.ndarray, high: np.ndarray, joint: int, is_negative: bool) -> None:
    if is_negative:
        high[joint] = 0.0
    else:
        low[joint] = 0.0
