"""`workbench check`: is a recording good enough, and what would improve it, before anything is fitted?"""

import math
from pathlib import Path

from workbench.commands.shared import answer, flow, tables
from workbench.core.text.uncertain import with_std


def command(
    recording: answer.RecordingName,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    trust_data: answer.TrustData = False,
    no_report: answer.NoReport = False,
) -> None:
    """Check a recording before calibration: joint ranges, poses, repeats, noise, mistakes and missing data.

    Exit status 1 if data are missing that the intended command requires, or if the data contain a mistake.
    """

    def work(run, progress) -> dict:
        import datasets
        from workbench.recordings.inspection import inspect_recording

        inspected = inspect_recording(datasets.read(recording, trust_data), progress)
        if not no_report:
            progress("writing the report")
            _write_report(inspected, run.partial)
        return {"recording": recording, **inspected.as_json()}

    flow.run("check", recording, out, json, work, _show)


def _write_report(inspected, folder: Path) -> None:
    from workbench.report import inspection
    from workbench.report.page import write_sheet

    write_sheet(inspection.page(inspected), folder)


def _show(console, result) -> None:
    title = f"{result['recording']}: {result['measures']}, {result['samples']} samples, {result['poses']} poses"
    joints = result["coverage"]["joints"]
    rows = []
    for joint in joints:
        unit = joint["joint"].rpartition("_")[2]
        share = joint["share_of_limits"]
        cells = [float(joint[f"{limit}_{unit}"]) for limit in ("min", "max", "range")]
        rows.append([joint["joint"], *cells, "–" if share is None else f"{100 * share:.0f} %"])
    if rows:
        tables.grid(console, title, ["joint", "min", "max", "range", "of limits"], rows)
    else:
        console.print(title, style="bold", markup=False)
    _show_images(console, result["images"])
    _show_hand_eye(console, result["hand_eye"])
    _show_noise(console, result)
    for need in result["missing"]:
        mark = "Required for" if need["required"] else "Useful for"
        mark = "To correct before" if need["mistake"] else mark
        style = "bold red" if need["required"] else None
        line = f"{mark} {need['command']}: {need['what']}; {need['action']}."
        console.print(line, style=style, markup=False, soft_wrap=True)


def _show_images(console, images) -> None:
    if images is None:
        return
    roles = ", ".join(f"{count} {role}" for role, count in images["roles"].items())
    boards_found = images["boards_found"]
    share = images["share_of_field"]
    console.print(
        f"Images: {roles}; board found in {boards_found}, corners cover {100 * share:.0f} % of the field.",
        markup=False,
    )


def _show_hand_eye(console, motions) -> None:
    """Relative motions of flange and camera, which do not depend on the hand-eye transform."""
    if motions is None:
        return
    angles = f"Flange and camera rotate by the same angles within {motions['angle_gap_deg']:.2g} deg (median)"
    lengths = _length_ratio(motions["scale"], motions["scale_std"])
    console.print(f"{angles}{lengths}.", markup=False)


def _length_ratio(scale: float, std: float) -> str:
    if math.isnan(scale):
        return ""
    return f"; lengths in the images are {with_std(scale, std)} times the flange's"


def _show_noise(console, result) -> None:
    repeats, noise = result["repeats"], result["noise_from_repeats_mm"]
    spread = result["coverage"]["orientation_spread_deg"]
    if spread == spread:
        console.print(f"Orientation spread of the flange: {spread:.3g} deg RMS.", markup=False)
    if repeats["groups"]:
        shown = "" if noise != noise else f"; noise {noise:.3g} mm (1 sigma of a coordinate)"
        console.print(
            f"Repeats: {repeats['rows']} rows of {repeats['groups']} poses{shown}.", markup=False
        )
