"""The load on the flange, of unknown mass and centre, from the start or after an instant; links that bend as beams."""

import numpy as np

from robot_model.chain import cross
from robot_model.effects.elastic import link_direction, link_line, one_each
from robot_model.effects.steps import AfterInstant
from robot_model.statics import STANDARD_GRAVITY
from workbench.core.covariates import clock, instant_format, instants_between
from workbench.core.effect import Effect, Grid, Variant
from workbench.core.parameters import Parameter

_LEVER_M, _DEFLECTION = 0.02, 3e-4  # m of lever that must vary; rad/N that a joint deflects by
_LOAD_KG = 1.0
_CENTRE_MM = 100.0
_MOST_SHARE, _FAR_MM = 0.5, 200.0
"""Prior sigma of a load's mass as a share of the arm's, and of its centre: light arms carry half of their own mass."""
_OFF_CENTRE_M = 0.1  # by which the centre of a load may be elsewhere


class Payload(Effect):
    """The tool carries a load of unknown mass and centre of mass, in addition to what is recorded.

    Mass and first moment in the flange frame (centre = first moment / mass); only seen through what deflects under the
    load. `after`: an instant in s where time was recorded, else the number of a row; absent: all the time.
    """

    effect = "payload"
    port = "mass"
    places = ("tool",)
    needs_compliance = True
    of_session = True
    coexists = True
    equation = "m -> m + d, m c -> m c + h, all the time or after an instant"
    source = "load identification: Khalil, Gautier & Lemoine, ICRA 2007; Swevers et al., IEEE Control Syst. 27 (2007)"
    unrecorded = "payload_kg"
    distinguished_by = "weigh the load and the tool"

    def __init__(self, where: str, after: float | None = None):
        super().__init__(where)
        self.after = after

    @property
    def confounded_with(self):
        """In all poses a constant load weighs as much as another mass of the last link than the robot file states."""
        label = "mass or centre of mass of the last link or the tool, wrong in the robot file"
        if self.after is None:
            return (("stated-masses", self.where, label),)
        return ()

    @classmethod
    def candidates(cls, chain):
        """A constant load, where masses are known, so that the load is distinguishable from them.

        It cannot weigh less than nothing: only a recorded load may be too heavy.
        """
        if chain.robot.mass.any():
            load = cls("tool")
            load.nonnegative = 0 if chain.state.payload.any() else 1
            yield Variant(load, "constant")

    @classmethod
    def grids(cls, chain):
        """Any instant between two samples, but for the first and the last two, where masses are known."""
        instants = instants_between(chain.state)
        if not chain.robot.mass.any() or not len(instants):
            return
        sizes = tuple(p.typical for p in cls("tool").table(chain))
        weights = np.ones(len(instants))
        label = f"after {instant_format(chain.state)}"
        yield Grid(cls, "tool", "after", "step", "time", instants, weights, sizes, label)

    def port_indices(self, chain):
        first = 3 * chain.robot.joints
        return (first + 3, first, first + 1, first + 2)

    def table(self, chain):
        mass = max(0.05 * float(chain.robot.mass.sum()), _LOAD_KG)
        largest_mass = max(_MOST_SHARE * float(chain.robot.mass.sum()), 3 * _LOAD_KG)
        label = "the load"
        suffix = ""
        if self.after is not None:
            instant = instant_format(chain.state).format(self.after)
            label = f"the load added after {instant}"
            suffix = f"_after_{self.after:g}"
        moments = [
            self.parameter(
                f"m{axis}{suffix}",
                "kg mm",
                mass * _CENTRE_MM,
                f"the first moment of {label} along {axis}",
                largest_mass * _FAR_MM,
            )
            for axis in "xyz"
        ]
        mass_parameter = self.parameter(
            f"mass{suffix}", "kg", mass, f"the mass of {label}", largest_mass
        )
        return (mass_parameter, *moments)

    def basis(self, state):
        is_present = np.ones(state.n)
        if self.after is not None:
            is_present = (clock(state) > self.after).astype(float)
        return np.eye(4)[:, :, None] * is_present


class PayloadCentre(Effect):
    """The recorded load has its centre of mass elsewhere than stated, or than at the measured point if none is stated.

    Three numbers in the flange frame; only seen through what deflects under the load. The masses of the links need not
    be known: the recorded load is.
    """

    effect = "payload-centre"
    port = "mass"
    places = ("tool",)
    needs_compliance = True
    equation = "m c -> m (c + d), m the recorded load"
    source = "load identification: Khalil, Gautier & Lemoine, ICRA 2007; here by deflections instead of torques"

    @classmethod
    def candidates(cls, chain):
        """One, where the recorded load changes: a constant one acts as another mass of the last link does."""
        if np.ptp(_recorded_load(chain.state)) > 0:
            yield Variant(cls("tool"))

    def port_indices(self, chain):
        first = 3 * chain.robot.joints
        return (first, first + 1, first + 2)

    def table(self, chain):
        label = "the centre of the recorded load beyond the stated one along"
        return tuple(
            self.parameter(axis, "mm", _CENTRE_MM, f"{label} {axis}", _FAR_MM) for axis in "xyz"
        )

    def basis(self, state):
        return np.eye(3)[:, :, None] * _recorded_load(state)


def _recorded_load(state) -> np.ndarray:
    """(n,) kg on top of the empty tool; 0 where none is recorded."""
    return state.payload - state.robot.payload_mass


class LoadDeflection(AfterInstant, Effect):
    """The tool carries another load after an instant, and the joints deflect by it; the links' masses are not known.

    One number a joint, its compliance times the change of weight, and the centre of the load relative to the measured
    point or the tool's centre of mass. The mass itself follows where the compliance of a joint is known.
    """

    effect = "payload"
    port = "joint"
    of_session = True
    needs_compliance = True
    places = ("tool",)
    elastic = True
    equation = (
        "dq_K = l_K (t_K(q) + c.u_K(q)) after an instant; t_K the torque of one newton at the assumed centre of the "
        "load, u_K that of a first moment along each axis of the flange"
    )
    source = (
        "linear torsion springs under a change of load: Ye et al., Sensors 24, 2559 (2024), eq. 22"
    )
    reads = ("time",)
    unrecorded = "payload_kg"

    @classmethod
    def grids(cls, chain):
        """Any instant between two samples, but for the first and the last two; every joint with a centre of its own.

        None where masses are known: `Payload` then says the same with fewer numbers. Centred, for a load that acts
        nearly all the time deflects the joints as the links' weight does, which is no change of load.
        """
        if chain.robot.mass.any():
            return
        instants = instants_between(chain.state)
        torques = unit_torques(chain.state)
        min_torque = np.array([_LEVER_M, *3 * [_LEVER_M / _OFF_CENTRE_M]])
        components, joints = np.nonzero(np.ptp(torques, axis=2) > min_torque[:, None])
        if len(instants) and len(components):
            weights = np.ones(len(instants))
            label = f"after {instant_format(chain.state)}"
            sizes = _DEFLECTION * np.array([1.0, *3 * [_OFF_CENTRE_M]])
            port_indices = tuple(joints.tolist())
            factor = torques[components, joints]
            typical = tuple(sizes[components].tolist())
            scanned = ("step", "time", instants, weights, typical, label, factor, port_indices)
            yield Grid(cls, "tool", "after", *scanned, centred=True)

    def port_indices(self, chain):
        return tuple(range(chain.robot.joints))

    def table(self, chain):
        table = []
        for k in range(1, chain.robot.joints + 1):
            unit = "mm" if chain.slides(k) else "rad/m"
            label = f"the deflection of joint {k} by the change of load"
            key = f"tool.{self.effect}.joint{k}"
            table.append(Parameter(key, unit, 0.0, _DEFLECTION, label, 30 * _DEFLECTION))
        for axis in "xyz":
            label = f"the centre of the change of load along {axis} of the flange"
            size = _OFF_CENTRE_M * 1e3
            table.append(self.parameter(f"centre_{axis}", "mm", size, label, 2 * size))
        return tuple(table)

    def _torque(self, p, state) -> np.ndarray:
        """(J, n) torque of one newton at the centre of the load, m."""
        centre = np.asarray(p[-3:]) * 1e-3
        return state.unit_load_torque + np.tensordot(centre, state.load_moment_torque, 1)

    def delta(self, p, state):
        is_after = clock(state) > self.after
        return np.asarray(p[:-3])[:, None] * self._torque(p, state) * is_after

    def derivative(self, p, state):
        is_after = clock(state) > self.after
        of_joints = one_each(self._torque(p, state) * is_after)
        of_centre = 1e-3 * np.asarray(p[:-3])[:, None] * state.load_moment_torque * is_after
        return np.concatenate([of_joints, of_centre])

    def basis(self, state):
        """(4 J, J, n) what the law can make at all, with a centre of each joint's."""
        is_after = clock(state) > self.after
        return np.concatenate([one_each(part * is_after) for part in unit_torques(state)])


def unit_torques(state) -> np.ndarray:
    """(4, J, n) torque about each joint of one newton at the load's centre, m, and of a first moment along x, y, z."""
    return np.concatenate([state.unit_load_torque[None], state.load_moment_torque])


class LinkBeam(Effect):
    """Link K bends as a beam under the gravity moments at its root and its tip, and twists about itself.

    A cantilever of constant section under a force and a moment at its tip: the rotation of the tip is that of a flexure
    at mid-link, its shift differs by L/12 times the difference of the moments at root and tip.
    """

    effect = "link-compliance"
    port = "frame"
    places = ("link",)
    elastic = True
    equation = (
        "w = c (M_root + M_tip) / 2 across + t M_mid along; shift + c L (M_root - M_tip) / 12"
    )
    source = "Euler-Bernoulli cantilever: Gere & Timoshenko, Mechanics of Materials, app. G; Klimchik et al. (2017)"
    nonnegative = 2

    @classmethod
    def candidates(cls, chain):
        """None: a flexure at mid-link is tested instead, which differs by a twelfth of the link's length."""
        return ()

    def table(self, chain):
        subject = f"link {self.number}'s"
        return (
            self.parameter("bending", "rad/(N m)", 3e-5, f"{subject} bending compliance", 3e-4),
            self.parameter("torsion", "rad/(N m)", 3e-5, f"{subject} torsional compliance", 3e-4),
        )

    def basis(self, state):
        moment = state.moment[self.number]
        vector = link_line(state, self.number)
        direction = link_direction(state, self.number)
        transverse = moment - direction[:, None] * (direction @ moment)
        difference = self._by_weight(state, vector)
        lever = np.broadcast_to((vector / 12)[:, None], difference.shape)
        out = np.zeros((2, 6, state.n))
        out[0, :3] = cross(difference, lever)
        out[0, 3:] = transverse
        out[1, 3:] = direction[:, None] * (direction @ moment)
        return out

    def _by_weight(self, state, vector: np.ndarray) -> np.ndarray:
        """(3, n) N m: moment at the root minus that at the tip, the link's vector times the weight beyond it."""
        masses = state.robot.mass[self.number :].sum() + state.payload
        gravity = np.einsum("cin,i->cn", state.frames.link[self.number], state.gravity)
        weight = gravity * masses * STANDARD_GRAVITY
        return cross(np.broadcast_to(vector[:, None] * 1e-3, weight.shape), weight)


__all__ = ["LinkBeam", "LoadDeflection", "Payload", "PayloadCentre"]
