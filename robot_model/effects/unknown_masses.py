"""Compliance under the weight of links whose masses nobody states: linear in compliance times first moment.

The gravity torque at a joint is linear in the first moments of the bodies beyond it, and only in their base (minimal)
combinations: Khalil & Dombre, Modeling, Identification and Control of Robots (2002), ch. 9. Compliance times first
moment times g is an angle: the deflection where the moment is horizontal. Only this product is identifiable without a
known load. What is expected before measuring follows from the lengths: each link a uniform bar between its joint axes.

A slide changes the lever of all that it carries. The moment is then linear in the carried masses, too: mass times the
lever of the frame behind the slide. The lengths between revolute joints are constant, so that such masses are no
further unknowns there: they are grouped with the first moments.
"""

from functools import lru_cache

import numpy as np

from robot_model.chain import cross, forward
from robot_model.robot import Robot
from workbench.core.effect import Effect, Variant
from workbench.core.parameters import Parameter

TYPICAL_RAD = 3e-4
"""Deflection of a joint under the whole arm stretched out: 0.3 mm at 1 m."""
_TILT_RAD = 1e-4  # of a bearing, a link or the foot
_OFF_THE_BAR, _LEAST_SHARE = (
    0.3,
    0.03,
)  # how far first moments are from those of uniform bars, and at least
_CONFIGURATIONS = 64
_DEPENDENT = 1e-6
_NO_BAR_MM = 1e-6
_UNDER_BARS = (
    0.05  # variation, of the greatest moment of the bars, below which no deflection is measurable
)


@lru_cache(maxsize=64)
def bar_shares(robot: Robot) -> np.ndarray:
    """(J,) expected first moment of every link with all beyond it, for uniform bars: its length times what it carries.

    Slides count with their nominal position. The sum over the links from K on normalises what joint K carries.
    """
    length = bar_lengths(robot)
    outward_length = np.cumsum(length[::-1])[::-1] - length
    return length * (length / 2 + outward_length)


def _shares_from(robot: Robot, first: int) -> np.ndarray:
    """(J,) those of links `first` ... J - 1, from 0; 0 of the others."""
    shares = bar_shares(robot).copy()
    shares[:first] = 0.0
    return shares


@lru_cache(maxsize=64)
def bar_lengths(robot: Robot) -> np.ndarray:
    """(J,) mm, lengths of the bars between the joint axes, the last one to the flange; slides in the middle."""
    frames = forward(robot, _middle(robot)[:, None], links=True)
    return np.linalg.norm(_bars(frames), axis=1)[:, 0]


def _middle(robot: Robot) -> np.ndarray:
    """(J,) joint variables: of slides in the middle of their limits, where these are known, else 0."""
    readings = np.nan_to_num(robot.limits.mean(1))
    return np.where(robot.prismatic, robot.mixing @ readings, 0.0)


@lru_cache(maxsize=64)
def _reach(robot: Robot) -> float:
    """Length (mm) of the stretched arm, the unit of the levers of carried masses."""
    return max(float(bar_lengths(robot).sum()), 1.0)


def _bars(frames) -> np.ndarray:
    """(J, 3, n) mm from a point on the axis of each joint to one on the next axis, the last to the flange."""
    ends = np.concatenate([frames.z_origin[1:], frames.end_origin[None]])
    return ends - frames.z_origin


def bar_moments(state, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit moments of the bars of links `first` ... J (from 0) under gravity, root frame (B, 3, n), and shares (B,).

    Links without a length between their axes are left out. The shares add up to 1. A bar that a slide lengthens has
    the moment 1 in the middle of the slide.
    """
    return _moments_of_bars(state, _shares_from(state.robot, first))


def _moments_of_bars(state, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `bar_moments`, of bars with shares (J,) in first moment."""
    bars = _bars(state.frames)
    used = shares > _NO_BAR_MM
    if not used.any():
        unit_moments = np.zeros((0, 3, state.n))
        return unit_moments, np.zeros(0)
    lengths = np.linalg.norm(bars[used], axis=1, keepdims=True)
    if state.robot.prismatic.any():
        lengths = bar_lengths(state.robot)[used, None, None]
    directions = bars[used] / lengths
    gravity = np.broadcast_to(state.gravity[:, None], directions.shape)
    return cross(directions, gravity), shares[used] / shares[used].sum()


@lru_cache(maxsize=256)
def base_columns(robot: Robot, first: int, with_all: bool = False) -> tuple[tuple[int, int], ...]:
    """(body, axis) of a minimal set of first moments in a torque, all from 0: bodies `first` ... J - 1.

    Axis 3 is the mass that a slide carries, see `_unit_moment`.

    Of the torque on the drive of joint `first`, or of the `with_all` moment vector there. Numerically, by QR of the
    regressor at random configurations: Gautier, J. Robotic Systems 8 (1991) 485. Bodies closer to the joint come
    first, so that the others are grouped with them.
    """
    rng = np.random.default_rng(0)
    variables = rng.uniform(-np.pi, np.pi, (robot.joints, _CONFIGURATIONS))
    variables[robot.prismatic] *= _reach(robot)
    frames = forward(robot, variables, links=True)
    if with_all or robot.coupling is None:
        start = first
    else:
        start = np.flatnonzero(robot.coupling[:, first])[0]
    axes = range(4 if robot.prismatic.any() else 3)
    names = [(body, axis) for body in range(start, robot.joints) for axis in axes]
    if with_all:
        columns = [
            _unit_moment(robot, frames, robot.gravity, first, *name).ravel() for name in names
        ]
    else:
        columns = [_unit_torque(robot, frames, robot.gravity, first, *name) for name in names]
    independent = []
    basis = np.zeros((len(columns[0]) if columns else 0, 0))
    for name, column in zip(names, columns):
        remainder = column - basis @ (basis.T @ column)
        size = float(np.linalg.norm(remainder))
        if size > _DEPENDENT * np.sqrt(_CONFIGURATIONS):
            independent.append(name)
            basis = np.concatenate([basis, remainder[:, None] / size], 1)
    return tuple(independent)


def _unit_torque(robot: Robot, frames, gravity, joint: int, body: int, axis: int) -> np.ndarray:
    """(n,) torque on the drive of a joint of a unit first moment along an axis of a body, per unit of gravity."""
    if robot.coupling is None:
        moment = _unit_moment(robot, frames, gravity, joint, body, axis)
        return (frames.z[joint] * moment).sum(0)
    torque = np.zeros(frames.z.shape[-1])
    for other in range(body + 1):  # turned by this drive, of the joints before the body
        if robot.coupling[other, joint] and not robot.prismatic[other]:
            moment = _unit_moment(robot, frames, gravity, other, body, axis)
            torque += robot.coupling[other, joint] * (frames.z[other] * moment).sum(0)
    return torque


def bar_torque(state, joint: int) -> np.ndarray:
    """(n,) torque of uniform bars on the drive of a joint (from 0), in units of the greatest about that joint."""
    robot = state.robot
    if robot.coupling is None:
        return _bar_torque_about(state, joint)
    total_share = max(_shares_from(robot, joint).sum(), _NO_BAR_MM)
    torque = np.zeros(state.n)
    for other in np.flatnonzero(robot.coupling[:, joint]):
        share = _shares_from(robot, other).sum() / total_share
        torque += robot.coupling[other, joint] * share * _bar_torque_about(state, other)
    return torque


def _bar_torque_about(state, joint: int) -> np.ndarray:
    moments, shares = bar_moments(state, joint)
    return np.einsum("b,bin,in->n", shares, moments, state.frames.z[joint])


def _unit_moment(robot: Robot, frames, gravity, first: int, body: int, axis: int) -> np.ndarray:
    """(3, n) moment of a unit first moment along an axis of a body, per unit of gravity, root frame.

    Axis 3: of a unit mass times the arm's length, at the origin of the frame after the body's joint, about a point on
    the axis of joint `first` (from 0).
    """
    if axis < 3:
        direction = frames.link[body + 1][axis]
    else:
        direction = (frames.origin[body] - frames.z_origin[first]) / _reach(robot)
    return cross(direction, np.broadcast_to(gravity[:, None], direction.shape))


def _name_of_moment(body: int, axis: int) -> tuple[str, str]:
    """Name and description of a first moment, or of a mass that a slide carries."""
    if axis == 3:
        return f"link{body + 1}_mass", f"mass at link {body + 1}"
    moment_label = f"first moment of link {body + 1} along {'xyz'[axis]}"
    return f"link{body + 1}_{'xyz'[axis]}", moment_label


def _of_bars(kind, chain, label: str = "") -> list[Variant]:
    """A variant at each place where the moment of uniform bars varies; none where masses are stated."""
    if chain.robot.mass.any():
        return []
    found = []
    for place in kind.places:
        for effect in map(kind, chain.places(place)):
            numbered = place in ("joint", "link")
            turns_no_slide = kind.port == "joint" and numbered and chain.slides(effect.number)
            if turns_no_slide or (numbered and effect.first() >= chain.robot.joints):
                continue
            if np.ptp(effect.basis(chain.state)[0], axis=-1).max() > _UNDER_BARS:
                found.append(Variant(effect, label))
    return found


class GravityCompliance(Effect):
    """Joint K deflects under the weight of the links, whose masses are not stated.

    `sag` is the deflection for uniform bars, at the greatest moment that they can have about the joint; the other
    parameters are compliance times further first moments of the base set, and times masses that slides carry. None of
    them is a stiffness: the compliance in rad/(N m) follows only with a known load (`joint-compliance`).
    """

    effect = "gravity-compliance"
    estimates_moments = True
    port = "joint"
    places = ("joint",)
    elastic = True
    turning = True
    equation = "dq = sag sum_i s_i z.(b_i x g) + sum_b p_b z.(e_b x g), p_b = lambda m_b g"
    source = (
        "base parameters: Khalil & Dombre (2002), ch. 9; Gautier, J. Robotic Systems 8 (1991) 485"
    )
    stage = "compliance"
    nonnegative = 1
    compliance_prior = (0.5, 1.0)

    @property
    def reads(self):
        return (f"tau{self.number}",)

    def first(self) -> int:
        """Number from 0 of the first link whose weight acts."""
        return self.number - 1

    @classmethod
    def candidates(cls, chain):
        """At every revolute joint whose torque would vary with uniform bars; none where masses are stated."""
        return _of_bars(cls, chain)

    @classmethod
    def planned(cls, chain):
        """The same."""
        return [(variant.effect.where, {}) for variant in cls.candidates(chain)]

    def table(self, chain):
        label = f"joint {self.number}'s deflection under the links"
        table = [self.parameter("sag", "rad", TYPICAL_RAD, label, 10 * TYPICAL_RAD)]
        shares = bar_shares(chain.robot)
        total_length = max(shares[self.number - 1 :].sum(), _NO_BAR_MM)
        for body, axis in base_columns(chain.robot, self.number - 1):
            share = max(_OFF_THE_BAR * shares[body] / total_length, _LEAST_SHARE)
            name, moment_label = _name_of_moment(body, axis)
            size = TYPICAL_RAD * share
            table.append(self.parameter(name, "rad", size, f"{label}, {moment_label}", 10 * size))
        return tuple(table)

    def basis(self, state):
        joint = self.number - 1
        columns = [
            _unit_torque(state.robot, state.frames, state.gravity, joint, body, axis)
            for body, axis in base_columns(state.robot, joint)
        ]
        return np.stack([bar_torque(state, joint), *columns])[:, None]

    def moments_of(self, other: "GravityCompliance", chain) -> np.ndarray:
        """(P, P') parameters for those of another joint's law under the same first moments.

        The first one is the deflection under uniform bars, of either. What the other law does not know is that of bars.
        """
        names = base_columns(chain.robot, self.number - 1)
        shares = bar_shares(chain.robot)[self.number - 1 :].sum()
        return _same_moments(names, shares, other, chain)


def _same_moments(names, shares: float, other: GravityCompliance, chain) -> np.ndarray:
    """(P, P') as of `GravityCompliance.moments_of`, for a law with first moments of (body, axis) `names` after its
    first parameter, whose bars have `shares` together."""
    ratio = bar_shares(chain.robot)[other.number - 1 :].sum() / shares
    known = base_columns(chain.robot, other.number - 1)
    out = np.zeros((len(names) + 1, len(known) + 1))
    out[0, 0] = 1.0
    for row, name in enumerate(names, 1):
        if name in known:
            out[row, 1 + known.index(name)] = ratio
    return out


def _tilt_table(effect: Effect, chain, subject: str) -> tuple[Parameter, ...]:
    """Parameters of what tilts: under uniform bars, and under the first moments of the base set."""
    label = f"{subject} {effect.where} under the links"
    shares = effect.shares(chain.robot)
    total_length = max(shares.sum(), _NO_BAR_MM)
    table = [effect.parameter("tilt", "rad", _TILT_RAD, label, 10 * _TILT_RAD)]
    for body, axis in base_columns(chain.robot, effect.first(), with_all=True):
        size = _TILT_RAD * max(_OFF_THE_BAR * shares[body] / total_length, _LEAST_SHARE)
        name, moment_label = _name_of_moment(body, axis)
        table.append(
            effect.parameter(f"tilt_{name}", "rad", size, f"{label}, {moment_label}", 10 * size)
        )
    return tuple(table)


def _moments_of_tilt(law: Effect, other: GravityCompliance, chain) -> np.ndarray:
    """(P, P') as of `GravityCompliance.moments_of`, for a law with the parameters of `_tilt_table`."""
    names = base_columns(chain.robot, law.first(), with_all=True)
    return _same_moments(names, law.shares(chain.robot).sum(), other, chain)


def _tilt_moments(state, law: Effect) -> np.ndarray:
    """(P, 3, n) unit moments, root frame: of all bars with their shares, then of each first moment of the base set."""
    unit_moments, shares = _moments_of_bars(state, law.shares(state.robot))
    total_moment = np.einsum("b,bin->in", shares, unit_moments)
    first = min(law.first(), state.robot.joints - 1)
    names = base_columns(state.robot, law.first(), with_all=True)
    columns = (_unit_moment(state.robot, state.frames, state.gravity, first, *n) for n in names)
    return np.stack([total_moment, *columns])


def _in_frame(state, place: int, world: np.ndarray) -> np.ndarray:
    """(P, 3, n) vectors of the root frame in the axes of a place of the frame port."""
    return np.einsum("cin,pin->pcn", state.frames.link[place], world)


class _Tilt:
    """A part tilts under the weight of links whose masses are not stated: what bearing, link and pedestal share."""

    effect = "gravity-compliance"
    estimates_moments = True
    port = "frame"
    elastic = True
    source = GravityCompliance.source
    nonnegative = 1
    compliance_prior = (0.15, 0.1)
    subject = ""

    @classmethod
    def candidates(cls, chain):
        """Variants where the moment of uniform bars varies; none where masses are stated."""
        return _of_bars(cls, chain)

    def first(self) -> int:
        """Number from 0 of the first link whose weight acts."""
        return self.number - 1

    def shares(self, robot: Robot) -> np.ndarray:
        """(J,) expected first moments of the uniform bars that act."""
        return _shares_from(robot, self.first())

    def moments_of(self, other: GravityCompliance, chain) -> np.ndarray:
        """(P, P') as of `GravityCompliance.moments_of`."""
        return _moments_of_tilt(self, other, chain)

    def table(self, chain):
        return _tilt_table(self, chain, self.subject)


class GravityBearing(_Tilt, Effect):
    """The bearing of joint K tilts under the weight of links whose masses are not stated.

    A rotation about a point on the axis of joint K, across that axis.
    """

    compliance_prior = (0.05, 0.1)
    places = ("joint",)
    stage = "bending"
    subject = "the tilt of the bearing of"
    equation = "w = sum_i t_i (b_i x g) across z"

    @property
    def confounded_with(self):
        return bearing_like_root(self, GravityLink.effect)

    @classmethod
    def candidates(cls, chain):
        """At every revolute joint whose moment across the axis would vary if the links were uniform bars."""
        return _of_bars(cls, chain, "of its bearing")

    @classmethod
    def planned(cls, chain):
        """At the revolute joints up to the last one whose torque would vary."""
        last = max((v.effect.number for v in GravityCompliance.candidates(chain)), default=0)
        return [(f"joint-{k}", {}) for k in range(1, last + 1) if not chain.slides(k)]

    def port_indices(self, chain):
        return chain.port_indices("frame", f"link-{self.number}")

    def basis(self, state):
        world = _tilt_moments(state, self)
        z = state.frames.z[self.number - 1]
        transverse = world - z * (world * z).sum(1, keepdims=True)
        turns = _in_frame(state, self.number, transverse)
        return about_axis(state, self.number, turns)


class GravityLink(_Tilt, Effect):
    """Link K bends about its middle under the weight of the links beyond it, whose masses are not stated."""

    places = ("link",)
    subject = "the bending of"
    components = (3, 4, 5)
    equation = "w = sum_i t_i (b_i x g) across the link"

    @property
    def confounded_with(self):
        return first_link_like_pedestal(self, GravityPedestal.effect)

    def shares(self, robot: Robot) -> np.ndarray:
        """(J,) expected first moments about mid-link of the uniform bars beyond it: half its length times their weight,
        and their own. The first moment of the link itself is that of the weight at its end."""
        shares = _shares_from(robot, self.number)
        length = bar_lengths(robot)
        shares[self.number - 1] = length[self.number - 1] / 2 * length[self.number :].sum()
        return shares

    def basis(self, state):
        world = _tilt_moments(state, self)
        direction = _bars(state.frames)[self.number - 1]
        direction = direction / np.maximum(np.linalg.norm(direction, axis=0), _NO_BAR_MM)
        transverse = world - direction * (world * direction).sum(1, keepdims=True)
        return _in_frame(state, self.number, transverse)


class GravityPedestal(_Tilt, Effect):
    """The base tilts about its origin under the weight of links whose masses are not stated."""

    places = ("base",)
    subject = "the tilt of"
    components = (3, 4)
    equation = "w = sum_i t_i (b_i x g) across the vertical"

    def first(self) -> int:
        """Number from 0 of the first link whose weight acts."""
        return 0

    def basis(self, state):
        return _in_frame(state, 0, _tilt_moments(state, self))[:, :2]


def bearing_like_root(effect: Effect, link_effect: str) -> tuple[tuple[str, str, str], ...]:
    """A link that bends at its root tilts about the axis of its joint's bearing, under the same moment."""
    return ((link_effect, f"link-{effect.number}", "at its root"),)


def first_link_like_pedestal(effect: Effect, other: str) -> tuple[tuple[str, str, str], ...]:
    """A pedestal with one compliance in all directions tilts as the first link does."""
    if effect.number == 1:
        return ((other, "base", "the same about x and y"),)
    return ()


def about_axis(state, number: int, turns: np.ndarray) -> np.ndarray:
    """(P, 6, n) twists of frame K that turn by `turns` (P, 3, n) about the origin of joint K's axis.

    The port turns about the middle of the link; the shift moves the pivot to the point on the axis about which the
    moment is taken. Moment and rotation about one point are those of a spring: they have a potential energy.
    """
    frames = state.frames
    lever = frames.pivot[number] - frames.z_origin[number - 1]
    lever = np.einsum("cin,in->cn", frames.link[number], lever)
    shifts = cross(turns, np.broadcast_to(lever, turns.shape))
    return np.concatenate([shifts, turns], 1)


__all__ = [
    "GravityBearing",
    "GravityCompliance",
    "GravityLink",
    "GravityPedestal",
    "about_axis",
    "bar_moments",
    "bar_torque",
    "bar_shares",
    "bearing_like_root",
    "base_columns",
    "first_link_like_pedestal",
]
