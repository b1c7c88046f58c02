"""Forward kinematics on torch for millions of samples, on a GPU or on the processor.

Forward kinematics, the derivative of a point on the flange and its normal equations, with the same formulas as the
arm's own chain: arrays keep the sample on the last axis, a rotation is its three column vectors. Lengths mm,
angles rad.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

CHUNK = {"cuda": 131_072, "cpu": 4096}
"""Samples whose rows are in memory at a time: on a card 45 rows of them take 140 MB in double precision, on a processor
they stay in its cache."""
_D = 1
_A = 2


@dataclass(frozen=True)
class Arm:
    """J joints: `geometry` (J, 5) theta, d, a, alpha, beta; `prismatic` (J,) bool; `convention` "distal" or "craig";
    `root`, `flange` (4, 4) fixed transforms before the first and after the last joint."""

    geometry: np.ndarray
    prismatic: np.ndarray
    convention: str
    root: np.ndarray
    flange: np.ndarray


@dataclass(frozen=True)
class JointEffect:
    """A linear effect on the joint port: rotation of joint `joint` (from 0) by `value` times `basis` (n,)."""

    joint: int
    basis: np.ndarray
    value: float


@dataclass(frozen=True)
class ArmFrames:
    """Of n samples: `axes` (J, 5, 3, n) about or along which each number of the geometry moves the rest, `points`
    (J, 5, 3, n) on those axes, `end` (3, 3, n) columns and `origin` (3, n) of the flange; world frame."""

    axes: object
    points: object
    end: object
    origin: object


def device() -> str:
    """ "cuda" where torch can use a graphics card, else "cpu"."""
    import torch

    return "cuda" if torch.cuda.is_available() else "cpu"


def forward_kinematics(arm: Arm, variables, base: np.ndarray) -> ArmFrames:
    """The frames of the arm at joint variables (J, n), a torch tensor that says device and precision too.

    base (4, 4): T_world_root. Convention "distal": Rz(q+theta) Tz(d) Tx(a) Rx(alpha) Ry(beta) (Hayati & Mirmirani
    1985); "craig": Ry(beta) Rx(alpha) Tx(a) Rz(q+theta) Tz(d) (Craig, Introduction to Robotics, eq. 3.6).
    """
    import torch

    def tensor(values):
        return torch.as_tensor(
            np.asarray(values, float), dtype=variables.dtype, device=variables.device
        )

    start = tensor(base @ arm.root)
    n = variables.shape[1]
    frame = [start[:3, c, None].expand(3, n) for c in range(3)]
    origin = start[:3, 3, None].expand(3, n)
    axes = []
    points = []
    for k in range(len(arm.geometry)):
        theta, d, a, alpha, beta = tensor(arm.geometry[k])
        joint_angle, shift = (
            (theta, d + variables[k]) if arm.prismatic[k] else (theta + variables[k], d)
        )
        step = _distal if arm.convention == "distal" else _craig
        frame, origin, own_axes, own_points = step(
            frame, origin, joint_angle, shift, a, alpha, beta
        )
        axes.append(torch.stack(own_axes))
        points.append(torch.stack(own_points))
    flange = tensor(arm.flange)
    origin = origin + sum(axis * t for axis, t in zip(frame, flange[:3, 3]))
    end = torch.stack([sum(axis * r for axis, r in zip(frame, flange[:3, c])) for c in range(3)])
    return ArmFrames(torch.stack(axes), torch.stack(points), end, origin)


def _distal(frame, origin, joint_angle, shift, a, alpha, beta):
    z = frame[2]
    first = origin
    frame = _rotated(frame, 2, joint_angle)
    origin = origin + frame[2] * shift + frame[0] * a
    x = frame[0]
    frame = _rotated(frame, 0, alpha)
    y = frame[1]
    return _rotated(frame, 1, beta), origin, (z, z, x, x, y), (first, first, origin, origin, origin)


def _craig(frame, origin, joint_angle, shift, a, alpha, beta):
    y = frame[1]
    first = origin
    frame = _rotated(frame, 1, beta)
    x = frame[0]
    frame = _rotated(frame, 0, alpha)
    origin = origin + frame[0] * a
    z = frame[2]
    second = origin
    frame = _rotated(frame, 2, joint_angle)
    return frame, origin + frame[2] * shift, (z, z, x, x, y), (second, second, first, first, first)


def _rotated(frame, about, angle):
    """The frame times an elementary rotation about one of its axes."""
    i = (about + 1) % 3
    j = (about + 2) % 3
    c = angle.cos()
    s = angle.sin()
    rotated = list(frame)
    rotated[i] = c * frame[i] + s * frame[j]
    rotated[j] = c * frame[j] - s * frame[i]
    return rotated


def derivative(
    arm: Arm, walked: ArmFrames, tool: np.ndarray, index, base: np.ndarray, bent: Sequence[tuple]
):
    """Point (3, n) and its derivative (6 + 5 J + 3 R + B, 3, n).

    tool (R, 3): points on the flange; index (n,) which of them. Columns: shift and small rotation of the base about the
    world's axes through the base's origin, geometry joint by joint, the points, and each of `bent`, pairs of a joint
    and its basis as a tensor.
    """
    import torch

    like = {"dtype": walked.origin.dtype, "device": walked.origin.device}
    places = torch.as_tensor(np.asarray(tool, float), **like)
    point = walked.origin + torch.einsum("cin,nc->in", walked.end, places[index])
    joints = len(arm.geometry)
    n = point.shape[1]
    rows = torch.empty((6 + 5 * joints + 3 * len(places) + len(bent), 3, n), **like)
    unit = torch.eye(3, **like)[:, :, None]
    rows[:3] = unit
    lever = point - torch.as_tensor(np.asarray(base[:3, 3], float), **like)[:, None]
    rows[3:6] = _cross(unit.expand(3, 3, n), lever)
    geometry = _cross(walked.axes, point - walked.points)
    geometry[:, _D : _A + 1] = walked.axes[:, _D : _A + 1]
    rows[6 : 6 + 5 * joints] = geometry.reshape(-1, 3, n)
    indicator = torch.nn.functional.one_hot(index, len(places)).to(**like).T
    rows[6 + 5 * joints : 6 + 5 * joints + 3 * len(places)] = (
        indicator[:, None, None] * walked.end
    ).reshape(-1, 3, n)
    for place, (joint, basis) in enumerate(bent, len(rows) - len(bent)):
        rows[place] = basis * geometry[joint, _D if arm.prismatic[joint] else 0]
    return point, rows


def _cross(a, b):
    """(..., 3, n) cross products."""
    import torch

    return torch.linalg.cross(a, b.expand_as(a), dim=-2)


def normal_equations(
    arm: Arm,
    variables: np.ndarray,
    base: np.ndarray,
    tool: np.ndarray,
    index: np.ndarray,
    measured: np.ndarray,
    sigma: float,
    bent: Sequence[JointEffect] = (),
    where: str | None = None,
    single: bool = False,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Whitened normal matrix (F, F), gradient (F,) and chi-square of all n samples, added up over chunks of them.

    variables (J, n) joint variables, base (4, 4), tool (R, 3), index (n,), measured (3, n), sigma mm; columns as of
    `derivative`. where: torch's device, a graphics card where there is one if None; single: single precision.
    """
    import torch

    like = {"dtype": torch.float32 if single else torch.float64, "device": where or device()}
    size = 6 + 5 * len(arm.geometry) + 3 * len(tool) + len(bent)
    # sums in double precision: a million of singles lose what the inverse needs
    normal = torch.zeros((size, size), dtype=torch.float64, device=like["device"])
    gradient = torch.zeros(size, dtype=torch.float64, device=like["device"])
    squares = 0.0
    chunk = CHUNK["cpu" if like["device"] == "cpu" else "cuda"]
    for first in range(0, variables.shape[1], chunk):
        part = slice(first, first + chunk)
        joint_values = torch.as_tensor(variables[:, part], **like).clone()
        bases = [
            (compliance.joint, torch.as_tensor(compliance.basis[part], **like))
            for compliance in bent
        ]
        for compliance, (joint, basis) in zip(bent, bases):
            joint_values[joint] += compliance.value * basis
        seen = torch.as_tensor(np.asarray(index[part]), device=like["device"])
        point, rows = derivative(
            arm, forward_kinematics(arm, joint_values, base), tool, seen, base, bases
        )
        white = (point - torch.as_tensor(measured[:, part], **like)).reshape(-1) / sigma
        flat = rows.reshape(size, -1) / sigma
        normal += (flat @ flat.T).double()
        gradient += (flat @ white).double()
        squares += float((white.double() ** 2).sum())
    return normal.cpu().numpy(), gradient.cpu().numpy(), squares
