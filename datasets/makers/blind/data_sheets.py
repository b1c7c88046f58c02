"""Data-sheet values of an arm: nominal rows of a robot file; missing masses and gear ratios are drawn.

The files of `robot_model/robots` are read as plain TOML, without code of `robot_model`.
"""

import tomllib
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

ROBOTS = Path(__file__).resolve().parents[3] / "robot_model" / "robots"
_ROW = ("theta_deg", "d_mm", "a_mm", "alpha_deg", "hayati", "sign", "coupled")
# How the mass of an arm of this kind is shared among its six bodies.
_SHARES = np.array([0.30, 0.27, 0.20, 0.12, 0.08, 0.03])
_LIMITS = "limits_deg"
_WIDEST = 175.0  # deg either way: more is another revolution of the same pose


def names() -> list[str]:
    """Names of the arms, as their files are called."""
    return sorted(path.stem for path in ROBOTS.glob("*.toml"))


def robot(name: str, rng: np.random.Generator) -> dict:
    """A robot.toml as a mapping: lengths of the manual, masses, tool and, in half of the cases, gear ratios."""
    nominal = tomllib.loads((ROBOTS / f"{name}.toml").read_text(encoding="utf-8"))
    rows = [{key: row[key] for key in _ROW if key in row} for row in nominal["joint"]]
    rows = [
        row | {"limits_deg": _limits(joint)} if _LIMITS in joint else row
        for row, joint in zip(rows, nominal["joint"])
    ]
    for row, body in zip(rows, _bodies(nominal["joint"], rng)):
        row.update(body)
    if rng.random() < 0.5:
        for row in rows:
            row["gear_ratio"] = int(rng.integers(50, 161))
    tool = {
        "mass_kg": round(rng.uniform(0.8, 2.5), 3),
        "com_mm": _rounded(rng.uniform([-40, -40, 20], [40, 40, 90])),
    }
    return {
        "name": nominal["name"],
        "convention": "distal",
        "gravity": [0.0, 0.0, -1.0],
        "source": "lengths of the maker's manual, masses by estimate",
        "payload": tool,
        "joint": rows,
    }


def limits_deg(row) -> list[float]:
    """Range of a joint's angle, deg; a joint that moves with another has none of its own in the manual."""
    return row.get(_LIMITS, [-120.0, 150.0])


def _limits(row) -> list[float]:
    low, high = row[_LIMITS]
    return [max(low, -_WIDEST), min(high, _WIDEST)]


def _bodies(rows, rng) -> list[dict]:
    """Mass and centre of mass of every body: the file's own, or half-way along each link."""
    if all("mass_kg" in row for row in rows):
        return [{"mass_kg": row["mass_kg"], "com_mm": row["com_mm"]} for row in rows]
    reach = sum(abs(row["d_mm"]) + abs(row["a_mm"]) for row in rows)
    total_kg = 28 * (reach / 1000) ** 1.5 * rng.uniform(0.8, 1.2)  # kg: small arms of this class
    return [
        {
            "mass_kg": round(float(total_kg * share), 3),
            "com_mm": _rounded(_half_way(row) + rng.uniform(-25, 25, 3)),
        }
        for row, share in zip(rows, _SHARES)
    ]


def _half_way(row) -> np.ndarray:
    """(3,) mm: the middle of the link in the frame at its end."""
    rotation = Rotation.from_euler("X", row["alpha_deg"], degrees=True).as_matrix()
    return -rotation.T @ np.array([row["a_mm"], 0.0, row["d_mm"]]) / 2


def _rounded(numbers) -> list[float]:
    return [round(float(x), 2) for x in numbers]
