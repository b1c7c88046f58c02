"""Effects of gravity on what is not stiff: joints, links, pedestal, tool, and a tilted mount."""

import numpy as np

from robot_model.effects.unknown_masses import (
    about_axis,
    bearing_like_root,
    first_link_like_pedestal,
)
from workbench.core.effect import Effect, Variant
from workbench.core.errors import InputError
from workbench.core.parameters import Parameter

SHIFTS, TURNS = (0, 1, 2), (3, 4, 5)
"""Components of a frame's small twist: mm, then rad."""
_LOADED_NM = 0.02
"""Variation of a load (N m) below which no deflection is measurable."""
_SHORTEST_MM = 1.0
"""Length below which a link has nothing that bends; what its neighbours do is theirs."""
_NO_LENGTH_MM = 1e-6


def _loaded_variants(kind, chain):
    """A variant at each of its places at which the load of its law varies; none where no mass is known."""
    if not chain.state.has_masses:
        return
    for place in kind.places:
        for effect in map(kind, chain.places(place)):
            if np.ptp(effect.load(chain.state), axis=1).max() > _LOADED_NM:
                yield Variant(effect)


def loaded_joints(chain) -> list[int]:
    """Numbers of the revolute joints whose gravity torque varies over the poses."""
    ranges = np.ptp(chain.state.torque, axis=1)
    return [k for k, load in enumerate(ranges, 1) if load > _LOADED_NM and not chain.slides(k)]


class LinkSelfWeight(Effect):
    """Joint K deflects under the gravity torque of the links alone, without tool and load."""

    effect = "link-self-weight"
    port = "joint"
    places = ("joint",)
    elastic = True
    equation = "dq = lambda tau_links(q)"
    source = "Ye et al., Sensors 24, 2559 (2024), eq. 25, with the full torque of the links"
    nonnegative = 1
    mass_dependent = True
    compliance_prior = (0.02, 1.0)

    @property
    def reads(self):
        return (f"tau{self.number}",)

    @classmethod
    def candidates(cls, chain):
        """Variants where the torque of the links varies, and a load makes it distinguishable from the whole torque."""
        if not chain.state.payload.any():
            return ()
        flexible_joints = {variant.effect.where for variant in JointCompliance.candidates(chain)}
        return [
            variant
            for variant in _loaded_variants(cls, chain)
            if variant.effect.where in flexible_joints
        ]

    def load(self, state):
        """(1, n) N m, the torque that it deflects under."""
        return state.self_torque[self.number - 1][None]

    def table(self, chain):
        label = f"joint {self.number}'s compliance to its links"
        return (
            self.parameter("compliance", joint_unit(chain, self.number), 3e-4, label, prior=3e-3),
        )

    def basis(self, state):
        return self.load(state)[None]


class JointCompliance(Effect):
    """Joint K deflects under the gravity torque of links and load about its axis."""

    effect = "joint-compliance"
    port = "joint"
    places = ("joint",)
    elastic = True
    equation = "dq = lambda tau(q, payload)"
    source = (
        "linear torsion spring: Ye et al., Sensors 24, 2559 (2024), eq. 22, with the full torque"
    )
    nonnegative = 1
    mass_dependent = True
    compliance_prior = (0.5, 1.0)
    # with its first mass moments estimated it includes a load of zero
    subsumes = (LinkSelfWeight.effect,)
    unrecorded = "payload"
    stage = "compliance"

    @property
    def reads(self):
        return (f"tau{self.number}",)

    @classmethod
    def candidates(cls, chain):
        """At every joint whose torque varies."""
        return _loaded_variants(cls, chain)

    @classmethod
    def planned(cls, chain):
        """The same, of revolute joints."""
        return [(f"joint-{k}", {}) for k in loaded_joints(chain)]

    def load(self, state):
        """(1, n) N m, the torque that it deflects under."""
        return state.torque[self.number - 1][None]

    def table(self, chain):
        label = f"joint {self.number}'s compliance"
        return (
            self.parameter("compliance", joint_unit(chain, self.number), 3e-4, label, prior=3e-3),
        )

    def basis(self, state):
        return self.load(state)[None]


class YeCompliance(Effect):
    """Ye's simplified compliance of a six-joint arm: six load terms and two of self-weight.

    dq_k = lambda_k t_k, with t_k the torque of one newton at the load centre (a lever in m), and
    dq_2 += lambda_2 (s1 sin q2 + s2 sin(q2 - q3)), dq_3 -= lambda_3 s2 sin(q2 - q3), where q2 = 0
    stands upright and the axes of joints 2 and 3 are opposite (alpha_2 = 180 deg).

    The paper prints a plus at joint 3. Statics wants a minus: the links' energy is
    F (s1 cos q2 + s2 cos(q2 - q3)), and the torque is its fall by q3. A plus needs axes 2 and 3
    alike, but then the forearm stands at q2 + q3.

    The load terms are regression coefficients: Table 1 has negative ones, so none is held at zero.
    """

    effect = "joint-compliance"
    port = "joint"
    places = ("joint",)
    elastic = True
    equation = "dq = lambda (J^T H e3 + N23 [s1, s2])"
    source = "Ye et al., Sensors 24, 2559 (2024), eq. 24-27 and Table 1, with the sign of joint 3 from statics"

    @classmethod
    def candidates(cls, chain):
        """None: the joints' own compliances are tested one by one, with the full torque."""
        return ()

    def table(self, chain):
        joints = chain.robot.joints
        if joints != 6:
            raise InputError(
                f"effect 'ye-compliance': expected an arm of six joints, found '{chain.robot.name}' "
                f"with {joints} joints; use joint-compliance instead"
            )
        # a gear of 20 kN m/rad under ten newtons; links of ten times that load, at a quarter of a metre
        loads = [
            Parameter(
                f"joint-{k}.{self.effect}.load",
                "rad/m",
                0.0,
                5e-4,
                f"the load compliance of joint {k}",
                1.5e-3,
            )
            for k in range(1, 7)
        ]
        weights = [
            Parameter(
                f"joint-{k}.{LinkSelfWeight.effect}.s{k - 1}",
                "mm",
                0.0,
                1e3,
                f"the self-weight term s{k - 1}",
                3e3,
            )
            for k in (2, 3)
        ]
        return (*loads, *weights)

    def port_indices(self, chain):
        return tuple(range(6))

    def delta(self, p, state):
        change = p[:6, None] * state.unit_load_torque
        upper, forearm = self._sines(state)
        change[1] += p[1] * (p[6] * upper + p[7] * forearm) * 1e-3
        change[2] -= p[2] * p[7] * forearm * 1e-3
        return change

    def derivative(self, p, state):
        upper, forearm = self._sines(state)
        out = np.zeros((8, 6, state.n))
        out[range(6), range(6)] = state.unit_load_torque
        out[1, 1] += (p[6] * upper + p[7] * forearm) * 1e-3
        out[2, 2] -= p[7] * forearm * 1e-3
        out[6, 1] = p[1] * upper * 1e-3
        out[7, 1] = p[1] * forearm * 1e-3
        out[7, 2] = -p[2] * forearm * 1e-3
        return out

    def _sines(self, state):
        return np.sin(state.variables[1]), np.sin(state.variables[1] - state.variables[2])


class LinkCompliance(Effect):
    """Link K bends under the gravity moment of the bodies beyond it.

    A rotation vector in frame K about the middle of link K, which runs from the foot of the common normal before it on
    the axis of joint K to the foot of its own on the next axis (the last link: to the flange). M is the gravity moment
    of bodies K+1 to J and the load about that point. Its component along the link is left out.
    """

    effect = "link-compliance"
    port = "frame"
    components = TURNS
    places = ("link",)
    elastic = True
    equation = "w = c M_transverse(q, payload)"
    source = "beam bending as a flexure at mid-link (virtual joint): Klimchik et al., Mech. Mach. Theory (2017)"
    nonnegative = 1
    mass_dependent = True
    compliance_prior = (0.15, 0.1)

    @property
    def confounded_with(self):
        return first_link_like_pedestal(self, PedestalCompliance.effect)

    @classmethod
    def candidates(cls, chain):
        """At every link that has a length and whose bending moment varies."""
        for variant in _loaded_variants(cls, chain):
            if np.linalg.norm(link_line(chain.state, variant.effect.number)) > _SHORTEST_MM:
                yield variant

    def load(self, state):
        """(3, n) N m, the gravity moment beyond the link about its pivot."""
        return state.moment[self.number]

    def table(self, chain):
        label = f"link {self.number}'s bending compliance"
        return (self.parameter("bending", "rad/(N m)", 3e-5, label, prior=3e-4),)

    def basis(self, state):
        moment = self.load(state)
        direction = link_direction(state, self.number)
        return (moment - direction[:, None] * (direction @ moment))[None]


class BearingCompliance(Effect):
    """The bearing of joint K tilts under the gravity moment across its axis.

    A rotation across the axis of joint K about a point on it: the origin of frame K-1 (Craig: of frame K). The moment
    is that of bodies K to J and the load about the same point, so that the bearing is a spring with an energy.
    """

    effect = "bearing-compliance"
    port = "frame"
    places = ("joint",)
    elastic = True
    equation = "w = c M_across(q, payload)"
    source = "bearing tilt as a virtual joint: Klimchik et al., Mech. Mach. Theory (2017)"
    nonnegative = 1
    mass_dependent = True
    compliance_prior = (0.05, 0.1)
    stage = "bending"

    @property
    def confounded_with(self):
        return bearing_like_root(self, LinkCompliance.effect)

    @classmethod
    def candidates(cls, chain):
        """At every joint whose moment across the axis varies."""
        return _loaded_variants(cls, chain)

    @classmethod
    def planned(cls, chain):
        """At the revolute joints up to the last one that gravity loads, where masses are stated."""
        if not chain.robot.mass.any():
            return ()
        last = max(loaded_joints(chain), default=0)
        return [(f"joint-{k}", {}) for k in range(1, last + 1) if not chain.slides(k)]

    def load(self, state):
        """(3, n) N m, the gravity moment across the axis."""
        return state.bearing_moment[self.number - 1]

    def port_indices(self, chain):
        return chain.port_indices("frame", f"link-{self.number}")

    def table(self, chain):
        label = f"the tilting compliance of joint {self.number}'s bearing"
        return (self.parameter("tilt", "rad/(N m)", 1e-4, label, prior=1e-3),)

    def basis(self, state):
        return about_axis(state, self.number, self.load(state)[None])


class PedestalCompliance(Effect):
    """The base tilts about its origin under the gravity moment of arm and load.

    It tilts about x and y of the base frame, with one compliance each. M is the moment about the origin of the base.
    """

    effect = "pedestal-compliance"
    port = "frame"
    places = ("base",)
    components = (3, 4)
    elastic = True
    equation = "w = c M_overturning(q, payload)"
    source = "flexure at the foot"
    nonnegative = 2
    mass_dependent = True
    compliance_prior = (0.15, 0.1)

    @classmethod
    def candidates(cls, chain):
        """Variants where the overturning moment varies."""
        return _loaded_variants(cls, chain)

    def load(self, state):
        """(3, n) N m, the gravity moment of arm and load about the origin of the base."""
        return state.moment[0]

    def table(self, chain):
        return tuple(
            self.parameter(
                f"about_{axis}", "rad/(N m)", 3e-5, f"the pedestal's compliance about {axis}"
            )
            for axis in "xy"
        )

    def basis(self, state):
        return one_each(self.load(state)[:2])


class ToolDeflection(Effect):
    """The flange origin shifts along each axis of the flange frame by c times the component of gravity along it."""

    effect = "tool-deflection"
    port = "frame"
    places = ("tool",)
    components = SHIFTS
    elastic = True
    equation = "dx = c g_in_tool"
    source = "shift of the measured point along gravity seen from the flange"

    def table(self, chain):
        return tuple(
            self.parameter(f"sag_{axis}", "mm", 0.05, f"the tool's sag along {axis}")
            for axis in "xyz"
        )

    def basis(self, state):
        values = np.einsum("cin,i->cn", state.frames.link[-1], state.gravity)
        return one_each(values)


class MountTilt(Effect):
    """Gravity is not along base -z; observable only through compliances that deflect under it."""

    effect = "mount-tilt"
    port = "gravity"
    places = ("base",)
    equation = "dg = tilt across the nominal gravity"
    source = "two direction cosines of gravity in the base frame"
    needs_compliance = True

    def table(self, chain):
        return tuple(
            self.parameter(f"tilt_{i}", "rad", 0.01, f"the tilt of gravity ({i})") for i in (1, 2)
        )

    def basis(self, state):
        gravity = state.robot.gravity
        horizontal = np.linalg.svd(gravity[None])[2][1:]
        return np.repeat(horizontal[:, :, None], state.n, 2)


class MountTorsion(Effect):
    """Gravity is not along base -z, so that an upright first joint is loaded and deflects.

    What that joint's compliance is, nothing else tells; the two numbers are its compliance times the tilt.
    """

    effect = "mount-tilt"
    port = "joint"
    places = ("base",)
    elastic = True
    needs_compliance = True
    equation = "dq_1 = lambda (t_1 tau_1 + t_2 tau_2), tau_i the torque of gravity across its nominal direction"
    source = "the torsion spring of joint-compliance under the two direction cosines of mount-tilt"

    @classmethod
    def candidates(cls, chain):
        """Variants if masses are known and the axis of joint 1 is so upright that nominal gravity does not load it."""
        if np.ptp(chain.state.torque[0]) <= _LOADED_NM and chain.state.has_masses:
            yield Variant(cls("base"), "where an upright joint 1 deflects under it")

    def port_indices(self, chain):
        return chain.port_indices("joint", "joint-1")

    def table(self, chain):
        label = "joint 1's compliance times the tilt of gravity"
        return tuple(
            self.parameter(f"torsion_{i}", joint_unit(chain, 1), 3e-6, f"{label} ({i})", 1e-4)
            for i in (1, 2)
        )

    def basis(self, state):
        horizontal = np.linalg.svd(state.robot.gravity[None])[2][1:]
        levers = state.link_levers.torque + state.load_levers.torque
        of_first_drive = state.robot.drive_torque(levers.swapaxes(0, 1))[:, 0]
        return np.einsum("ai,in->an", horizontal, of_first_drive)[:, None]


def joint_unit(chain, number: int) -> str:
    """Unit of a joint's compliance: a slide deflects in mm under a force, and typically by as much."""
    return "mm/N" if chain.robot.prismatic[number - 1] else "rad/(N m)"


def one_each(values):
    """(c, c, n) basis in which each of c components, values (c, n), has a parameter of its own."""
    return np.eye(len(values))[:, :, None] * values[None]


def link_line(state, number: int) -> np.ndarray:
    """(3,) mm from where link K (from 1) begins to where it ends, in the axes of frame K; see `Frames`."""
    frames = state.frames
    return np.einsum("ci,i->c", frames.link[number][..., 0], frames.link_vector(number)[:, 0])


def link_direction(state, number: int) -> np.ndarray:
    """(3,) unit vector along link K in the axes of frame K; that of its joint's axis where it has no length."""
    line = link_line(state, number)
    length = np.linalg.norm(line)
    frames = state.frames
    if length > _NO_LENGTH_MM:
        return line / length
    return np.einsum("ci,i->c", frames.link[number][..., 0], frames.z[number - 1][:, 0])


class FirstMoment(Effect):
    """The mass of a link or of the tool is not where the data sheet puts it.

    Three numbers a body, its mass times the place of its centre; observable only through compliances.
    """

    effect = "first-moment"
    port = "mass"
    places = ("link", "tool")
    equation = "m c -> m c + d"
    stage = "compliance"

    @classmethod
    def candidates(cls, chain):
        """None: the elastic effects are tested with their first moments estimated jointly."""
        return ()

    @classmethod
    def planned(cls, chain):
        """Of the loaded links between the first and the last two, and of the tool."""
        loaded = loaded_joints(chain)
        links = [f"link-{k}" for k in loaded if 1 < k < chain.robot.joints - 1]
        return [(where, {}) for where in (*links, *(["tool"] if loaded else []))]

    source = "first moments as in rigid-body identification: Atkeson, An & Hollerbach, Int. J. Robot. Res. 5 (1986)"

    @staticmethod
    def prior_size(robot) -> float:
        """kg mm: a tenth of the arm's mass times 100 mm, or 100 kg mm where masses are unknown."""
        return max(10.0 * float(robot.mass.sum()), 100.0)

    def table(self, chain):
        size = self.prior_size(chain.robot)
        return tuple(
            self.parameter(
                f"m{axis}",
                "kg mm",
                size,
                f"the first moment of {self.where} along {axis}",
                prior=size,
            )
            for axis in "xyz"
        )

    def basis(self, state):
        return np.repeat(np.eye(3)[:, :, None], state.n, 2)
