"""Construction robot: a Doosan arm on a lifting column, a total station, and two accelerometers.

YAML, one file a ground: column height -> arm solution -> stationing and evaluation measurements
with joint states (m, then rad), the prism's place in the total station's frame (m), and the
accelerometers on the column's base and tip (m/s^2).

The one lift reading c moves two segments of the column alike. In the URDF they are
column_middle_joint = 0.5 c - 0.706 m and column_top_joint = 0.5 c - 0.736 m; with the tip 1.442 m
above the top segment the arm stands exactly c above the column's foot. The joint that c is named
after carries nothing. Heights from 1.98 to 3.87 m measured with one setting of the total station
agree with this within the arm's own errors (10 mm, nominal).
"""

from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.formats.native import checked, digest
from datasets.recording import Recording

STATION_MM = 0.75
"""1 sigma of a coordinate of the prism."""
URDF = "data/trailblazer.urdf"
# As in the URDF, and in its units (m).
MIMIC = {
    "column_middle_joint": {"joint": "column_prismatic_joint", "ratio": 0.5, "offset": -0.706},
    "column_top_joint": {"joint": "column_prismatic_joint", "ratio": 0.5, "offset": -0.736},
}
MEASUREMENT_KEYS = ("stationing_measurements", "evaluation_measurements")


def read(folder: Path, variant: str) -> Recording:
    """Rows in order of time; `set` is 0 for stationing and 1 for evaluation measurements.

    Covariates: accelerations of column base and tip, column_height_mm (as commanded), solution (of
    the arm), upside_down (0 or 1), time_s.
    """
    import yaml

    paths = checked(folder, f"data/datasets/{variant}.yaml", URDF)
    try:
        content = yaml.load(
            paths[0].read_text(encoding="utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        )
        rows = sorted(_rows(content), key=lambda row: row["time_s"])
        columns = {key: np.array([row[key] for row in rows], float) for key in rows[0]}
        joints = list(content["joint_names"])
    except (yaml.YAMLError, KeyError, TypeError, AttributeError, IndexError, ValueError) as problem:
        raise complaint(
            f"{folder.name}/{variant}.yaml",
            "the layout of the published file",
            str(problem)[:60],
            "fetch it again",
        ) from None
    columns["time_s"] -= columns["time_s"][0]
    robot = {"urdf": str(paths[1]), "joints": joints, "mimic": MIMIC, "tip": "tool_link"}
    columns = {"sample": np.arange(1.0, len(rows) + 1), **columns}
    return Recording(
        "external-point",
        columns,
        robot,
        title=f"Doosan arm on a lifting column, ground: {variant}",
        sigma_mm=STATION_MM,
        sha256=digest(paths),
    )


def _rows(content: dict):
    """Every measurement as a flat row in file units."""
    for height, station in content["column_heights"].items():
        for solution, measured in station["solution_spaces"].items():
            for part, key in enumerate(MEASUREMENT_KEYS):
                for measurement in measured[key]:
                    yield _row(measurement) | {
                        "column_height_mm": 1000 * height,
                        "solution": solution,
                        "set": part,
                    }


def _row(measurement: dict) -> dict:
    lift, *arm = measurement["joint_states"]
    row = {"q1_mm": 1000 * lift} | {f"q{k}_deg": np.rad2deg(a) for k, a in enumerate(arm, 2)}
    row |= {f"{axis}_mm": 1000 * v for axis, v in zip("xyz", measurement["prism_position"])}
    for place, key in (("base", "tilt_sensor_base_accel"), ("column", "tilt_sensor_column_accel")):
        row |= {f"accel_{place}_{axis}_m_s2": v for axis, v in zip("xyz", measurement[key])}
    return row | {"time_s": measurement["time"], "upside_down": float(measurement["upside_down"])}
