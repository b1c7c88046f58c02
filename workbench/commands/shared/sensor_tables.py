"""Terminal output of the sensor commands; each function reads only the JSON answer."""

import math
from collections.abc import Mapping, Sequence

from workbench.commands.shared.tables import grid, measured, number

_SHOWN = 40  # largest number of balls in the table
_NAMED = 6  # largest number of scans in a sentence
_SENTENCES = 12  # largest number of different sentences on scans or images


_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def camera(console, answer: Mapping) -> None:
    """Errors and parameters of a camera; `answer`: the object of `camera --json`."""
    title = (
        f"{answer['recording']}: camera from {answer['views']} images; RMS reprojection error "
        f"{number(answer['rms_px'])} px (2-D distance, as in OpenCV), {number(answer['rms_coordinate_px'])} px per "
        "coordinate"
    )
    std = answer["std"]
    rows = [
        [key, *measured(answer[key], std.get(key))] for key in ("fx_px", "fy_px", "cx_px", "cy_px")
    ]
    is_fisheye = answer.get("model") == "fisheye"
    names = ("k1", "k2", "k3", "k4") if is_fisheye else _COEFFICIENTS
    rows += [
        [name, *measured(*pair)]
        for name, *pair in zip(names, answer["distortion"], std["distortion"])
    ]
    grid(console, title, ["parameter", "value", "1 sigma"], rows)
    _models(console, answer.get("model_choice"))
    for sentence in _about_camera(answer):
        console.print(f"- {sentence}", markup=False)
    console.print()
    rejected(console, answer["rejected"])


def _models(console, choice: Mapping | None) -> None:
    """The models of the lens, compared by their errors on held-out board poses."""
    if choice is None:
        return
    rows = []
    for row in choice["candidates"]:
        excess = "–" if row["excess_percent"] is None else "0"
        if row["excess_percent"]:
            excess = " ± ".join(measured(row["excess_percent"], row["standard_error_percent"]))
        errors = [number(row[key]) for key in ("rms_px", "held_out_rms_px")]
        model = f"{row['model']} (chosen)" if row["model"] == choice["chosen"] else row["model"]
        rows.append([model, row["parameters"], *errors, excess, row["corners_left_out"]])
    heads = [
        "model",
        "parameters",
        "RMS px",
        "held-out RMS px",
        "above the best, %",
        "corners left out",
    ]
    grid(
        console,
        "Models of the lens (held-out RMS: on board poses that the fit did not see)",
        heads,
        rows,
    )


def _about_camera(answer: Mapping) -> Sequence[str]:
    """Sentences on the warp of the board, the held-out images, and parameters that are not identifiable."""
    sentences, held_out, bow = [], answer.get("held_out"), answer.get("bow")
    if bow is not None:
        height = " ± ".join(measured(bow["height_mm"], bow["height_std_mm"]))
        sentences.append(f"the board is warped by {height} mm (1 sigma)")
    if held_out is not None:
        sentences.append(held_out["sentence"])
    return [*sentences, *answer.get("undetermined", ()), *answer.get("notes", ())]


def rejected(console, rows: Sequence[Mapping], others: int = 0) -> None:
    """Rejected images with their reasons; `others`: number of further ones that are not in `rows`."""
    for row in rows[:_SENTENCES]:
        console.print(f"rejected: {row['image']}: {row['why']}", markup=False, soft_wrap=True)
    if (unlisted_count := len(rows[_SENTENCES:]) + others) > 0:
        console.print(f"and {unlisted_count} more (listed in the JSON)")
    if rows:
        console.print()


def scanner(console, answer: Mapping) -> None:
    """Camera, planes and mirror; `answer`: the object of `scanner --json`."""
    camera(console, {"recording": answer["recording"], **answer["camera"]})
    title = (
        f"{_counted(len(answer['planes']), 'light plane')}, {answer['stripe_points']:,} stripe points: RMS "
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
        console.print(f"- {sentence}", markup=False)
    console.print()
    rejected(console, answer["rejected"])


def scan(console, answer: Mapping) -> None:
    """Balls of each scan and the acceptance figures; `answer`: the object of `scan --json`."""
    head = ["scan", "ball", "points", "x mm", "y mm", "z mm", "RMS mm", "1 sigma mm", ""]
    rows, unseen, outcomes, points, unlisted_rows, others, unlisted = [], [], {}, 0, 0, 0, 0
    for scan_answer in answer[
        "scans"
    ]:  # one pass: the scans of a long session are read from disk in each pass, and few are kept
        points, balls = points + scan_answer["points"], _balls(scan_answer)
        unlisted_rows += max(len(rows) + len(balls) - _SHOWN, 0)
        rows += balls[: _SHOWN - len(rows)]
        others += max(len(unseen) + len(scan_answer["rejected"]) - _SENTENCES, 0)
        unseen += scan_answer["rejected"][: _SENTENCES - len(unseen)]
        unlisted += not _noted(outcomes, scan_answer["outcome"], scan_answer["scan"])
    grid(
        console,
        f"{answer['recording']}: {_counted(len(answer['scans']), 'scan')}, {points:,} points",
        head,
        rows,
    )
    if unlisted_rows:
        console.print(f"and {unlisted_rows} more (listed in the JSON)\n")
    for sentence, scans in outcomes.items():
        names = ", ".join(scans[:_NAMED]) + " ..." * (len(scans) > _NAMED)
        console.print(f"- scan {names}: {sentence}", markup=False, soft_wrap=True)
    if unlisted:
        console.print(f"- {unlisted} more scans have other remarks (listed in the JSON)")
    rejected(console, unseen, others)
    figures = [
        [row["name"].replace("_", " "), row["symbol"], *_valued(row)]
        for row in answer["acceptance"]
    ]
    figures = [row for row in figures if row[2] is not None]
    if figures:
        console.print()
        grid(
            console,
            "Acceptance figures, worst scan",
            ["characteristic", "symbol", "value", "unit"],
            figures,
            left=2,
        )


def _noted(outcomes: dict[str, list[str]], sentence: str, scan: str) -> bool:
    """Add a scan to its sentence, with a limited number of names; False if there are too many sentences."""
    if not sentence or sentence in outcomes or len(outcomes) < _SENTENCES:
        names = outcomes.setdefault(sentence, []) if sentence else []
        names += [scan] * (len(names) <= _NAMED)
        return True
    return False


def _balls(scan_answer: Mapping) -> list[list]:
    """One row per ball of a scan, with its largest sigma and the reasons for its exclusion, and per candidate."""
    rows = []
    for ball in scan_answer["balls"]:
        remarks = {"cut": ball["cut_by_field"], "too far": ball["beyond_calibrated_depths"]}
        place, spread = (ball["x_mm"], ball["y_mm"], ball["z_mm"]), max(ball["std_mm"])
        reasons = ", ".join(remark for remark, applies in remarks.items() if applies)
        figures = (
            *(measured(value, spread)[0] for value in place),
            number(ball["rms_mm"], 2),
            number(spread, 2),
        )
        rows.append([scan_answer["scan"], ball["ball"], ball["used"], *figures, reasons])
    for other in scan_answer.get("refused", ()):
        place = [number(other[key], 4) for key in ("x_mm", "y_mm", "z_mm")]
        rows.append([scan_answer["scan"], None, other["points"], *place, None, None, "refused"])
    return rows if scan_answer["balls"] else [*rows, [scan_answer["scan"], *[None] * 7, "no ball"]]


def _counted(number_of: int, noun: str) -> str:
    """'1 scan', '2,000 scans'."""
    return f"{number_of:,} {noun}{'' if number_of == 1 else 's'}"


def _valued(row: Mapping) -> tuple:
    """Value and unit of a characteristic; shares in %."""
    return (
        (100 * row["value"], "%")
        if row["unit"] == "1" and row["value"] is not None
        else (row["value"], row["unit"])
    )


def _profiler(answer: Mapping) -> list[str]:
    """Lines on noise and scale of the profiler's z, and on the estimated radius of the sphere."""
    lines = [f"noise of a profile: {number(answer['noise'])} {answer['noise_unit']}"]
    if answer.get("range_scale_std"):
        lines.append(
            f"scale error of the profiler's z (positive: z is measured too long): {answer['range_scale']:+.2%}, "
            f"1 sigma {answer['range_scale_std']:.2%}"
        )
    if answer.get("free_radius_std_mm") and not answer["radius_std_mm"]:
        radius, std = measured(answer["free_radius_mm"], answer["free_radius_std_mm"])
        lines.append(f"radius, if estimated: {radius} mm, 1 sigma {std} mm")
    return lines


_ERRORS = {
    "rms_px": "corners, RMS distance, px",
    "rms_mm": "distance from the sphere, RMS, mm",
    "pose_rms_mm": "the same with equal weight per pose, mm",
    "origin_mm": "board origin, RMS, mm",
    "centre_mm": "board centre, RMS, mm",
    "turn_deg": "board rotation, RMS, deg",
    "mean_origin_mm": "board origin, mean, mm",
    "mean_centre_mm": "board centre, mean, mm",
    "mean_turn_deg": "board rotation, mean, deg",
    "least_origin_mm": "smallest scatter of any hand-eye transform: origin, RMS, mm",
    "least_turn_deg": "its rotation (1 rad as 300 mm), RMS, deg",
}

_ERRORS_OF_KIND = {
    "target-pose": {key: text.replace("board", "target") for key, text in _ERRORS.items()},
    "external-point": {"rms_mm": "distance of the measured points, RMS, mm"},
}
_SCATTERING = {"target-pose": "estimated target pose", "external-point": "measured points"}


def handeye(console, answer: Mapping) -> None:
    """Transform, errors and warnings of a hand-eye calibration; `answer`: the object of `handeye --json`."""
    sensor = answer["hand_eye"]
    for sentence in answer["undetermined"]:
        console.print(f"Warning: {sentence}", style="bold red", markup=False, soft_wrap=True)
    values, spreads = (
        (*sensor["xyz_mm"], *sensor["rotvec_deg"]),
        (*sensor["std_mm"], *sensor["rotvec_std_deg"]),
    )
    names = ("x mm", "y mm", "z mm", "rx deg", "ry deg", "rz deg")
    rows = [
        [name, measured(value, std)[0], known(std)]
        for name, value, std in zip(names, values, spreads)
    ]
    title = f"{answer['recording']}: {answer['transform']}, {answer['poses']} poses"
    grid(console, title, ["", "value", "1 sigma"], rows)
    frame = "base" if answer["transform"] == "T_base_sensor" else "flange"
    console.print(
        f"Takes points from the frame of the sensor to that of the {frame}; rx ry rz is a rotation vector. "
        "hand-eye.toml has the 4x4 matrix and the covariance.\n",
        markup=False,
    )
    if answer.get("radius_mm") is not None:
        radius, std = measured(answer["radius_mm"], answer["radius_std_mm"])
        console.print(
            f"radius of the sphere: {radius} mm, {'certified' if std == '–' else f'1 sigma {std} mm'}"
        )
        for line in _profiler(answer):
            console.print(line, markup=False)
        console.print()
    keys = [key for key in answer["fit"] if key in answer["held_out"]]
    measures = answer.get("measures")
    if measures == "external-point":
        _measured_point(console, answer["target"])
        keys.remove("pose_rms_mm")  # each pose has one point
    words = _ERRORS | _ERRORS_OF_KIND.get(measures, {})
    rows = [
        [words.get(key, key.replace("_", " ")), answer["fit"][key], answer["held_out"][key]]
        for key in keys
    ]
    grid(
        console,
        f"Scatter of the {_SCATTERING.get(measures, 'estimated board pose or sphere')} over the poses",
        ["", "fit", "held out"],
        rows,
    )
    for sentence in answer.get("notes", ()):
        if sentence.startswith("scale of the board") and sentence.endswith(", kept"):
            console.print(f"Note: {sentence}.\n", markup=False, soft_wrap=True)
    rejected(console, answer["rejected"])


def _measured_point(console, target: Mapping) -> None:
    """Place of the measured point on the flange, which is the tool centre point where the tool carries it."""
    values = zip("xyz", target["xyz_mm"], target["std_mm"])
    words = ", ".join(
        f"{axis} {measured(value, std)[0]} ± {known(std)}" for axis, value, std in values
    )
    console.print(f"{target['transform'].capitalize()}: {words} mm.\n", markup=False)


def known(std: float | None) -> str:
    """1 sigma, or "not identifiable"."""
    return "not identifiable" if std is None or not math.isfinite(std) else number(std, 2)
