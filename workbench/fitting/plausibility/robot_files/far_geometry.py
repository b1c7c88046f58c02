"""Lengths and angles of an arm that are far from its robot file, and the robot of the library that needs none."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from robot_model.files.loading import builtin_robots, load_robot
from robot_model.measurements import samples_of
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.fitting.plausibility.fitting import Fit, fit_recording, nominal_scale
from workbench.fitting.plausibility.good_fit import good_scale
from workbench.fitting.plausibility.sampling import even_rows
from workbench.fitting.plausibility.suspicion import Suspicion
from workbench.fitting.plausibility.wording import far_parameters, listed

CAUSE = "geometry"
OTHER_ROBOT = "other-robot"
MAX_DEVIATION = 6.0
"""Prior standard deviations beyond which no tolerance of manufacture explains a geometry parameter."""
_UNUSUAL = 3.0
"""Prior standard deviations from which the robots of the library are tried: a similar model may differ by little."""
_PLAUSIBLE = 3.0
_ROWS = 240
_TESTED = 2
_AS_GOOD = 1.5
_EVIDENCE = 10.0
"""Difference of the negative log posteriors of two robots: odds of 20000."""


@dataclass(frozen=True)
class FarGeometry:
    """`parameters`: "d4 = 174.23 mm instead of 163.94", ...; `other`: name of the library robot that fits without."""

    robot: str
    parameters: tuple[str, ...]
    other: str | None

    @property
    def verdict(self) -> str:
        """The finding and the action, for a verdict."""
        return f"{self.what[0].upper()}{self.what[1:]}; {self.action}."

    @property
    def what(self) -> str:
        """The finding."""
        return (
            f"the data fit '{self.robot}' only with {listed(self.parameters)}, far more than tolerances of manufacture "
            "explain"
        )

    def suspicion(self, recording) -> Suspicion:
        """The same as a possible mistake of a recording."""
        sentence = f"robot file of recording '{recording.name}': {self.what}; {self.action}."
        return Suspicion(sentence, False, CAUSE if self.other is None else OTHER_ROBOT)

    @property
    def action(self) -> str:
        """Recommended action."""
        if self.other is None:
            return "check these numbers of the robot file and the zero position of the arm"
        return (
            f"the library robot '{self.other}' fits without such deviations: name it instead (--robot {self.other} of "
            f'`workbench import`, or builtin = "{self.other}" under [robot] of recording.toml)'
        )


def find_far_geometry(robot: Robot, recording) -> FarGeometry | None:
    """Report parameters far from the nominal robot of a recording; None where none is, or where nothing fits.

    recording: of any kind that a robot is calibrated with. The geometry of a bad fit says nothing about the arm.
    """
    try:
        samples = samples_of(recording)
        fit = fit_recording(robot, samples.select(even_rows(samples, _ROWS)))
    except (np.linalg.LinAlgError, InputError, ValueError):
        return None
    fits = np.isfinite(fit.scale) and fit.core <= good_scale(robot, samples)
    return far_geometry(robot, samples, fit) if fits else None


def far_geometry(robot: Robot, recording, fit: Fit) -> FarGeometry | None:
    """Parameters far from the nominal robot in the robust fit of a recording, and a library robot that fits."""
    parameters = far_parameters(fit, _UNUSUAL)
    if not parameters:
        return None
    other = _other_robot(robot, recording, fit)
    if other is None:
        parameters = far_parameters(fit, MAX_DEVIATION)
    return FarGeometry(robot.name, parameters, other) if parameters else None


def _other_robot(robot: Robot, recording, recorded: Fit) -> str | None:
    """Name of the most probable robot of the library that fits as well with plausible errors; None without one."""
    chosen = recording.select(even_rows(recording, _ROWS))
    screened = sorted(
        (nominal_scale(known, chosen), name) for name, known in _robots_of_same_kind(robot)
    )
    # a geometry that no tolerance explains needs no further evidence against it
    is_far = np.abs(recorded.deviations).max(initial=0.0) > MAX_DEVIATION
    needed, fits = 0.0 if is_far else _EVIDENCE, []
    for _, name in screened[:_TESTED]:
        try:
            fit = fit_recording(load_robot({"builtin": name}), chosen)
        except (np.linalg.LinAlgError, InputError):
            continue
        worst = np.abs(fit.deviations).max(initial=0.0)
        gain = recorded.improbability - fit.improbability
        if fit.scale < _AS_GOOD * recorded.scale and worst < _PLAUSIBLE and gain > needed:
            fits.append((fit.improbability, name))
    return min(fits)[1] if fits else None


def _robots_of_same_kind(robot: Robot) -> Iterator[tuple[str, Robot]]:
    """Robots of the library with joints of the same kinds."""
    for name in builtin_robots():
        known = load_robot({"builtin": name})
        is_same = known.convention == robot.convention and np.array_equal(
            known.geometry, robot.geometry
        )
        has_same_kinds = np.array_equal(known.prismatic, robot.prismatic)
        if has_same_kinds and known.mixing.shape == robot.mixing.shape and not is_same:
            yield name, known
