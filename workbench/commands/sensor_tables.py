"""How the answers of the sensor's commands look in a terminal; each function reads the JSON answer alone."""

from collections.abc import Mapping, Sequence

from workbench.commands.tables import grid, number


def camera(console, answer: Mapping) -> None:
    """Errors and parameters of a camera; `answer`: the object of `camera --json`."""
    title = (
        f"{answer['recording']}: {answer['views']} pictures, RMS {number(answer['rms_px'])} px as OpenCV counts, "
        f"{number(answer['rms_coordinate_px'])} px a coordinate"
    )
    std = answer["std"]
    rows = [[key, answer[key], std.get(key)] for key in ("fx_px", "fy_px", "cx_px", "cy_px")]
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    rows += [[name, *pair] for name, *pair in zip(names, answer["distortion"], std["distortion"])]
    grid(console, title, ["parameter", "value", "std"], rows)
    rejected(console, answer["rejected"])


def rejected(console, rows: Sequence[Mapping], most: int = 12) -> None:
    """Pictures that were left out, each with its reason."""
    for row in rows[:most]:
        console.print(f"left out: {row['image']}: {row['why']}", markup=False, soft_wrap=True)
    if len(rows) > most:
        console.print(f"and {len(rows) - most} more, which the JSON names")
    if rows:
        console.print()


def scanner(console, answer: Mapping) -> None:
    """Camera, planes and mirror; `answer`: the object of `scanner --json`."""
    camera(console, {"recording": answer["recording"], **answer["camera"]})
    title = (
        f"{len(answer['planes'])} light planes, {answer['stripe_points']:,} points of stripes: RMS "
        f"{number(answer['plane_rms_mm'])} mm from their plane, {number(answer['plane_rms_px'])} px along the scan line"
    )
    planes = answer["planes"]
    shown = planes if len(planes) <= 8 else [planes[k * (len(planes) - 1) // 7] for k in range(8)]
    rows = [[str(p["step"]), *p["normal"], p["offset_mm"], p["rms_mm"], p["sigma_mm"]] for p in shown]
    grid(console, title, ["step", "nx", "ny", "nz", "offset mm", "RMS mm", "1 sigma mm"], rows)
    if answer["left_out"]:
        console.print(answer["left_out"]["sentence"], markup=False)
    for sentence in answer["sentences"]:
        console.print(f"- {sentence}", markup=False, soft_wrap=True)
    console.print()


def scan(console, answer: Mapping) -> None:
    """Balls of each scan and the acceptance figures; `answer`: the object of `scan --json`."""
    rows = []
    for one in answer["scans"]:
        rows += [
            [
                one["scan"],
                ball["ball"],
                one["points"],
                ball["x_mm"],
                ball["y_mm"],
                ball["z_mm"],
                ball["radius_mm"],
                ball["rms_mm"],
                max(ball["std_mm"]),
            ]
            for ball in one["balls"]
        ] or [[one["scan"], None, one["points"]] + [None] * 6]
    head = ["scan", "ball", "points", "x mm", "y mm", "z mm", "radius mm", "RMS mm", "largest 1 sigma mm"]
    grid(console, f"{answer['recording']}: {len(answer['scans'])} scans", head, rows[:40])
    if len(rows) > 40:
        console.print(f"and {len(rows) - 40} more, which the JSON names\n")
    told = [
        [row["name"], row["symbol"], row["value"], row["unit"]]
        for row in answer["acceptance"]
        if row["value"] is not None
    ]
    grid(console, "Acceptance figures", ["characteristic", "symbol", "value", "unit"], told, left=2)


def handeye(console, answer: Mapping) -> None:
    """Transform, errors and doubts of a hand-eye calibration; `answer`: the object of `handeye --json`."""
    sensor = answer["hand_eye"]
    rows = [
        [axis, value, std] for axis, value, std in zip(("x mm", "y mm", "z mm"), sensor["xyz_mm"], sensor["std_mm"])
    ]
    rows += [[f"r{axis} deg", value, std] for axis, value, std in zip("xyz", sensor["rotvec_deg"], sensor["std_deg"])]
    grid(console, f"{answer['recording']}: {answer['transform']}, {answer['poses']} poses", ["", "value", "std"], rows)
    keys = [key for key in answer["fit"] if key in answer["held_out"]]
    rows = [[key.replace("_", " "), answer["fit"][key], answer["held_out"][key]] for key in keys]
    grid(console, "Errors", ["", "fit", "held out"], rows)
    for sentence in (*answer["undetermined"], *answer["suspicions"]):
        console.print(f"- {sentence}", markup=False, soft_wrap=True)
    rejected(console, answer["rejected"])
