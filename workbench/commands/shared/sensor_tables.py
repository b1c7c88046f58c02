"""How the answers of the sensor's commands look in a terminal; each function reads the JSON answer alone."""

import math
from collections.abc import Mapping, Sequence

from workbench.commands.shared.tables import grid, measured, number

_SHOWN = 40  # balls that a terminal names
_NAMED = 6  # scans that a sentence names
_SENTENCES = 12  # of scans or images; those of a long session may all differ


def camera(console, answer: Mapping) -> None:
    """Errors and parameters of a camera; `answer`: the object of `camera --json`."""
    title = (
        f"{answer['recording']}: {answer['views']} images, RMS {number(answer['rms_px'])} px as OpenCV counts, "
        f"{number(answer['rms_coordinate_px'])} px a coordinate"
    )
    std = answer["std"]
    rows = [
        [key, *measured(answer[key], std.get(key))] for key in ("fx_px", "fy_px", "cx_px", "cy_px")
    ]
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    rows += [
        [name, *measured(*pair)]
        for name, *pair in zip(names, answer["distortion"], std["distortion"])
    ]
    grid(console, title, ["parameter", "value", "1 sigma"], rows)
    for sentence in _about_camera(answer):
        console.print(f"- {sentence}", markup=False, soft_wrap=True)
    console.print()
    rejected(console, answer["rejected"])


def _about_camera(answer: Mapping) -> Sequence[str]:
    """The board's bow, how well images that were left out are predicted, and what stays open."""
    told, held, bow = [], answer.get("held_out"), answer.get("bow")
    if bow is not None:
        height = " ± ".join(measured(bow["height_mm"], bow["height_std_mm"]))
        told.append(f"the board is bowed by {height} mm (1 sigma)")
    if held is not None:
        told.append(held["sentence"])
    return [*told, *answer.get("undetermined", ())]


def rejected(console, rows: Sequence[Mapping], others: int = 0) -> None:
    """Images that were left out, each with its reason; `others` that are not in `rows`."""
    for row in rows[:_SENTENCES]:
        console.print(f"left out: {row['image']}: {row['why']}", markup=False, soft_wrap=True)
    if (more := len(rows[_SENTENCES:]) + others) > 0:
        console.print(f"and {more} more, which the JSON names")
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
    rows = [
        [
            p["step"],
            *(f"{n:.5f}" for n in p["normal"]),
            f"{p['offset_mm']:.3f}",
            number(p["rms_mm"], 2),
            number(
                p["sigma_mm"] if p["sigma_best_frame_mm"] is None else p["sigma_best_frame_mm"], 2
            ),
        ]
        for p in shown
    ]
    grid(console, title, ["step", "nx", "ny", "nz", "offset mm", "RMS mm", "1 sigma mm"], rows)
    if answer["left_out"]:
        console.print(answer["left_out"]["sentence"], markup=False)
    for sentence in answer["sentences"]:
        console.print(f"- {sentence}", markup=False, soft_wrap=True)
    console.print()
    rejected(console, answer["rejected"])


def scan(console, answer: Mapping) -> None:
    """Balls of each scan and the acceptance figures; `answer`: the object of `scan --json`."""
    head = ["scan", "ball", "points", "x mm", "y mm", "z mm", "RMS mm", "1 sigma mm", ""]
    rows, unseen, outcomes, points, more, others, untold = [], [], {}, 0, 0, 0, 0
    for one in answer[
        "scans"
    ]:  # once: a long session's are read anew each time, and few of them kept
        points, balls = points + one["points"], _balls(one)
        more += max(len(rows) + len(balls) - _SHOWN, 0)
        rows += balls[: _SHOWN - len(rows)]
        others += max(len(unseen) + len(one["rejected"]) - _SENTENCES, 0)
        unseen += one["rejected"][: _SENTENCES - len(unseen)]
        untold += not _noted(outcomes, one["outcome"], one["scan"])
    grid(
        console,
        f"{answer['recording']}: {len(answer['scans'])} scans, {points:,} points",
        head,
        rows,
    )
    if more:
        console.print(f"and {more} more, which the JSON names\n")
    for sentence, scans in outcomes.items():
        names = ", ".join(scans[:_NAMED]) + " ..." * (len(scans) > _NAMED)
        console.print(f"- scan {names}: {sentence}", markup=False, soft_wrap=True)
    if untold:
        console.print(f"- {untold} more scans: other sentences, which the JSON holds")
    rejected(console, unseen, others)
    told = [
        [row["name"].replace("_", " "), row["symbol"], *_valued(row)]
        for row in answer["acceptance"]
    ]
    told = [row for row in told if row[2] is not None]
    if told:
        console.print()
        grid(
            console,
            "Acceptance figures, the worst scan",
            ["characteristic", "symbol", "value", "unit"],
            told,
            left=2,
        )


def _noted(outcomes: dict[str, list[str]], sentence: str, scan: str) -> bool:
    """Whether there is room among the sentences for a scan's; few names of scans are kept with each."""
    if not sentence or sentence in outcomes or len(outcomes) < _SENTENCES:
        names = outcomes.setdefault(sentence, []) if sentence else []
        names += [scan] * (len(names) <= _NAMED)
        return True
    return False


def _balls(one: Mapping) -> list[list]:
    """A row for each ball of a scan: the largest of its three sigmas, and what keeps it from counting."""
    rows = []
    for ball in one["balls"]:
        doubts = {"cut": ball["cut_by_field"], "too far": ball["beyond_calibrated_depths"]}
        place, spread = (ball["x_mm"], ball["y_mm"], ball["z_mm"]), max(ball["std_mm"])
        said = ", ".join(doubt for doubt, there in doubts.items() if there)
        figures = (
            *(measured(value, spread)[0] for value in place),
            number(ball["rms_mm"], 2),
            number(spread, 2),
        )
        rows.append([one["scan"], ball["ball"], ball["used"], *figures, said])
    return rows or [[one["scan"], *[None] * 7, "no ball"]]


def _valued(row: Mapping) -> tuple:
    """A characteristic's value and unit; shares in %."""
    return (
        (100 * row["value"], "%")
        if row["unit"] == "1" and row["value"] is not None
        else (row["value"], row["unit"])
    )


def _profiler(answer: Mapping) -> list[str]:
    """Lines on the scale of a profiler's z, its noise and the ball's radius where that is fitted."""
    told = [f"noise of a profile: {number(answer['noise'])} {answer['noise_unit']}"]
    if answer.get("range_scale_std"):
        told.append(
            f"scale of the profiler's z: {answer['range_scale']:+.2%}, 1 sigma {answer['range_scale_std']:.2%}"
        )
    if answer.get("free_radius_std_mm") and not answer["radius_std_mm"]:
        radius, std = measured(answer["free_radius_mm"], answer["free_radius_std_mm"])
        told.append(f"with a radius of its own: {radius} mm, 1 sigma {std} mm")
    return told


_ERRORS = {
    "rms_px": "corners, RMS distance, px",
    "rms_mm": "points from the ball, RMS, mm",
    "pose_rms_mm": "the same, every pose alike, mm",
    "origin_mm": "board's origin, RMS, mm",
    "centre_mm": "board's middle, RMS, mm",
    "turn_deg": "board's turn, RMS, deg",
    "mean_origin_mm": "board's origin, mean, mm",
    "mean_centre_mm": "board's middle, mean, mm",
    "mean_turn_deg": "board's turn, mean, deg",
    "least_origin_mm": "least scatter of any hand-eye: origin, RMS, mm",
    "least_turn_deg": "its turn (1 rad as 300 mm), RMS, deg",
}


def handeye(console, answer: Mapping) -> None:
    """Transform, errors and doubts of a hand-eye calibration; `answer`: the object of `handeye --json`."""
    sensor = answer["hand_eye"]
    for sentence in answer["undetermined"]:
        console.print(f"Warning: {sentence}", style="bold red", markup=False, soft_wrap=True)
    values, spreads = (
        (*sensor["xyz_mm"], *sensor["rotvec_deg"]),
        (*sensor["std_mm"], *sensor["std_deg"]),
    )
    names = ("x mm", "y mm", "z mm", "rx deg", "ry deg", "rz deg")
    rows = [
        [name, measured(value, std)[0], known(std)]
        for name, value, std in zip(names, values, spreads)
    ]
    title = f"{answer['recording']}: {answer['transform']}, {answer['poses']} poses"
    grid(console, title, ["", "value", "1 sigma"], rows)
    if answer.get("radius_mm") is not None:
        radius, std = measured(answer["radius_mm"], answer["radius_std_mm"])
        console.print(
            f"radius of the ball: {radius} mm, {'known' if std == '–' else f'1 sigma {std} mm'}"
        )
        for line in _profiler(answer):
            console.print(line, markup=False)
        console.print()
    keys = [key for key in answer["fit"] if key in answer["held_out"]]
    rows = [
        [_ERRORS.get(key, key.replace("_", " ")), answer["fit"][key], answer["held_out"][key]]
        for key in keys
    ]
    grid(
        console,
        "How far apart what stands still seems to be, pose by pose",
        ["", "fit", "held out"],
        rows,
    )
    rejected(console, answer["rejected"])


def known(std: float | None) -> str:
    """1 sigma, or that there is none."""
    return "not determined" if std is None or not math.isfinite(std) else number(std, 2)
