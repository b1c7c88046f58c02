"""Page of a hand-eye calibration: errors by pose, scatter of the estimated board pose, and a 3-D view."""

from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from scipy.spatial.transform import Rotation

from workbench.fitting.verdicts.hand_eye_verdict import (
    flange_error_words,
    flange_errors,
    is_rotation_seen,
    robot_sigma,
    suspicions,
    undetermined,
)
from workbench.jobs.sensor.hand_eye import TO_HAND, HandEyeRun
from workbench.report import style
from workbench.report.provenance import flat
from workbench.report.sections import Page, Section, facts, figure, note, table, thumbnails, words
from workbench.report.sensor import space
from workbench.report.text import counted, decimals_of, fixed, rounded, sentence

_WORDS = {
    "rms_px": "corners, RMS distance (px)",
    "rms_mm": "points, RMS distance from the sphere (mm)",
    "sensor_rms_px": "corners, RMS distance with the flange poses estimated (px)",
    "pose_rms_mm": "poses, RMS of the RMS by pose (mm)",
    "origin_mm": "scatter of the board origin, RMS distance from its mean (mm)",
    "centre_mm": "scatter of the board centre, RMS distance from its mean (mm)",
    "turn_deg": "scatter of the board rotation, RMS angle from its mean (deg)",
    "mean_origin_mm": "scatter of the board origin, mean distance from its mean (mm)",
    "mean_centre_mm": "scatter of the board centre, mean distance from its mean (mm)",
    "mean_turn_deg": "scatter of the board rotation, mean angle from its mean (deg)",
    "least_origin_mm": "smallest scatter of any hand-eye transform: board origin, RMS (mm)",
    "least_turn_deg": "the same: board rotation, RMS, 1 rad weighted as 300 mm (deg)",
}

_OF_POINTS = {"rms_mm": "distance of the measured points, RMS (mm)"}
"""Errors of points on the flange: each pose has one, so that none is weighted by pose."""
_NOT_DETERMINED = "The errors of the flange poses are not estimated: camera or hand-eye transform is not determined."
_NAMED = 40  # largest number of bars that carry their names
_RAGGED = " points left out, off the circle or at its ragged ends"


def page(run: HandEyeRun) -> Page:
    """The whole page of `workbench handeye`."""
    hand_eye = run.made
    where = {
        "in-hand": "camera on the flange",
        "to-hand": "stationary instrument" if run.is_of_external_points else "stationary camera",
        "profiles": "profiler on the flange",
        "clouds": "3-D sensor on the flange",
    }
    sections = (
        Section("poses", "Pose by pose", tuple(_poses(run))),
        Section("errors", "Prediction errors", tuple(_errors(run))),
        Section("space", "In space", tuple(_space(run))),
        Section("transform", "Transform", tuple(_transform(run))),
        Section(
            "provenance",
            "Provenance",
            (
                facts(
                    [
                        ("recording", run.recording.name),
                        ("camera", run.source),
                        *_provenance(run.recording),
                    ]
                ),
            ),
        ),
    )
    return Page(
        f"Hand-eye calibration · {where[hand_eye.kind]}",
        run.recording.title or run.recording.name,
        tuple(_numbers(run)),
        tuple(lead(run)),
        sections,
        warning=_warning(run),
        files=("hand-eye.toml",),
    )


def _warning(run):
    """Reservations that apply to all numbers."""
    hand_eye = run.made
    suspicions_and_gaps = (*suspicions(run), *undetermined(run))
    return " ".join(
        sentence(line)
        for line in (*(() if hand_eye.converged else (hand_eye.outcome,)), *suspicions_and_gaps)
    )


def _numbers(run):
    hand_eye = run.made
    if run.is_of_target_poses:
        yield "target scatter, held out", rounded(hand_eye.held_out["origin_mm"]), "mm"
        yield "rotation scatter, held out", rounded(hand_eye.held_out["turn_deg"]), "deg"
        yield "target scatter, fit", rounded(hand_eye.fit["origin_mm"]), "mm"
        return
    if "origin_mm" in hand_eye.held_out:
        yield "board scatter, held out", rounded(hand_eye.held_out["origin_mm"]), "mm"
        yield "rotation scatter, held out", rounded(hand_eye.held_out["turn_deg"]), "deg"
        yield "board scatter, fit", rounded(hand_eye.fit["origin_mm"]), "mm"
    elif run.is_of_external_points:
        yield "distance of the points, held out", rounded(hand_eye.held_out["rms_mm"]), "mm"
        yield "fit", rounded(hand_eye.fit["rms_mm"]), "mm"
        return
    else:
        yield "distance from the sphere, held out", rounded(hand_eye.held_out["rms_mm"]), "mm"
        yield "fit", rounded(hand_eye.fit["rms_mm"]), "mm"
    yield "sensor’s noise", rounded(hand_eye.noise), hand_eye.unit


def _flange_sentence(spread) -> str:
    """RMS errors of the flange poses, 3-D like all other errors of the page."""
    place, rotation = flange_errors(spread)
    start = "The flange poses are modelled with random errors"
    if rotation is not None:
        return f"{start}; their {flange_error_words(spread)}."
    return f"{start}; estimated RMS 3-D position error: {rounded(place)} mm{_of_radius(spread)}."


def lead(run: HandEyeRun) -> list[str]:
    """Meaning of the numbers."""
    hand_eye = run.made
    poses = counted(len(run.flange), "pose")
    quantity = (
        "scatter of the measured points in the frame of the flange"
        if run.is_of_external_points
        else f"scatter of the estimated pose of the {_target(run)}"
        if hand_eye.radius is None
        else "scatter of the measured ball centres in the base frame"
        if hand_eye.kind == "clouds"
        else "distance of the profile points from the common sphere"
    )
    spread = robot_sigma(run)
    if run.is_of_target_poses and None not in spread.values():
        return [_held_out_sentence(quantity, poses), _target_sentence(spread)]
    robot = _NOT_DETERMINED if None in spread.values() else _flange_sentence(spread)
    return [_held_out_sentence(quantity, poses), robot]


def _held_out_sentence(quantity: str, poses: str) -> str:
    return f"{quantity.capitalize()}, over {poses}. Held out: each pose is predicted from the other poses only."


def _target(run: HandEyeRun) -> str:
    if run.is_of_target_poses:
        return "target on the flange" if run.made.kind == TO_HAND else "stationary target"
    return "stationary board"


def _target_sentence(spread) -> str:
    """RMS errors of measured poses whose share of the flange and of the camera is not separable."""
    place, rotation = np.sqrt(3) * spread["position_mm"], np.sqrt(3) * spread["rotation_deg"]
    return (
        f"Flange poses and measured poses of the target together have estimated RMS errors of {rounded(place)} mm (3-D "
        f"position of the target) and {rounded(rotation)} deg (angle of its rotation); the stated uncertainty of the "
        "transform accounts for them."
    )


def _of_radius(spread) -> str:
    """Variation of the radius over the profiles; empty for sensors that measure whole centres."""
    if "radius_mm" not in spread:
        return ""
    return f". The radius that a profile shows varies with 1 σ = {rounded(spread['radius_mm'])} mm"


def _poses(run):
    hand_eye = run.made
    if run.is_of_target_poses:
        yield from _target_poses(run)
        return
    yield figure(
        "perpose",
        _bars(run),
        f"RMS residual of each pose with the recorded flange poses ({hand_eye.unit}); held out: "
        "predicted from the other "
        "poses. Orange: excluded as an outlier.",
    )
    place, rotation = flange_errors(hand_eye.robot_sigma)
    is_seen = rotation is not None and is_rotation_seen(place, rotation)
    rows = [
        (
            name,
            rounded(row.residual),
            rounded(row.held_out),
            rounded(row.moved_mm),
            rounded(row.rotation_deg) if is_seen else "–",
        )
        for name, row in zip(run.names, hand_eye.poses)
    ]
    head = [
        "pose",
        f"residual ({hand_eye.unit})",
        f"held out ({hand_eye.unit})",
        "flange error (mm)",
        "flange rotation error (deg)",
    ]
    if run.is_of_external_points:  # one point does not tell its own error from that of the flange
        head = head[:3]
        rows = [row[:3] for row in rows]
    yield table(head, rows)
    outliers = [sentence(row.why) for row in hand_eye.poses if row.why]
    if outliers:
        yield note("Excluded poses", outliers)
    if run.rejected:
        yield words(f"{counted(len(run.rejected), 'image')} rejected:")
        yield thumbnails(
            [
                (run.recording.folder / rejection.image, f"{rejection.image}: {rejection.why}")
                for rejection in run.rejected[:24]
            ]
        )


def _target_poses(run):
    """Errors of the measured poses of a target, in position and rotation."""
    yield figure(
        "perpose",
        _bars(run),
        "Distance of the measured position of the target from its adjusted position (mm); held out: predicted from the "
        "other poses. Orange: excluded as an outlier.",
    )
    rows = [
        (name, rounded(row.residual), rounded(row.held_out), rounded(row.rotation_deg))
        for name, row in zip(run.names, run.made.poses)
    ]
    yield table(["pose", "position (mm)", "position, held out (mm)", "rotation (deg)"], rows)
    outliers = [sentence(f"{n}: {row.why}") for n, row in zip(run.names, run.made.poses) if row.why]
    if outliers:
        yield note("Excluded poses", outliers)


def _bars(run) -> go.Figure:
    rows = run.made.poses
    place = np.arange(1, len(run.made.poses) + 1)
    figure = style.figure(340, "pose, in the order of the recording", f"RMS ({run.made.unit})")
    is_outlier = np.array([row.outlier for row in rows])
    for name, values, colour in (
        ("fit", [row.residual for row in rows], style.GREEN),
        ("held out", [row.held_out for row in rows], style.BLUE),
    ):
        figure.add_bar(
            x=place,
            y=values,
            name=name,
            customdata=run.names,
            marker_line_width=0,
            marker_color=np.where(is_outlier, style.ORANGE, colour),
            hovertemplate="%{customdata}: %{y:.3f}<extra>" + name + "</extra>",
        )
    figure.update_layout(barmode="group", bargap=0.25)
    if len(rows) > _NAMED:
        return figure.update_xaxes(dtick=max(1, len(rows) // 15))
    short = [Path(name).stem for name in run.names]
    return figure.update_xaxes(tickvals=place, ticktext=short, title_text="image or pose")


def _errors(run):
    hand_eye = run.made
    words_of = _WORDS
    if run.is_of_target_poses:
        words_of = {key: text.replace("board", "target") for key, text in _WORDS.items()}
    elif run.is_of_external_points:
        words_of = _OF_POINTS
    rows = [
        (words_of[key], rounded(value), rounded(hand_eye.held_out.get(key)))
        for key, value in hand_eye.fit.items()
        if key in words_of
    ]
    yield table(["", "fit", "held out"], rows)
    suspicions_and_gaps = [sentence(line) for line in (*suspicions(run), *undetermined(run))]
    if suspicions_and_gaps:
        yield note("Reservations, and parameters that are not identifiable", suspicions_and_gaps)
    for line in _gathered(hand_eye.notes):
        yield words(sentence(line), quiet=True)


def _gathered(notes) -> list[str]:
    """Notes; equal notes on single profiles are combined into one."""
    same = [line for line in notes if line.endswith(_RAGGED)]
    if len(same) < 3:
        return list(notes)
    by_profile = ", ".join(line.removesuffix(_RAGGED) for line in same)
    return [
        f"points left out, off the circle or at its ragged ends: {by_profile}",
        *(n for n in notes if n not in same),
    ]


def _space(run):
    yield words(
        "Flange, camera and target of every pose in the base frame of the arm."
        if run.is_of_target_poses
        else "Flange and sensor of every pose in the base frame of the arm; a pyramid shows the field of view of the "
        "camera."
        if run.made.radius is None
        else "Flange and measured point of every pose, and the instrument, in the base frame of the arm."
        if run.is_of_external_points
        else "Flange and profiler of every pose, and the sphere, in the base frame of the arm."
    )
    yield figure("space3d", scene(run), "Drag to rotate.")


def scene(run: HandEyeRun) -> go.Figure:
    """Flanges, sensors and their targets in the base frame, mm."""
    hand_eye = run.made
    figure = space.space()
    flange = run.flange
    if hand_eye.kind == TO_HAND:
        sensors = hand_eye.sensor[None]
        boards = flange @ hand_eye.target
    else:
        sensors = flange @ hand_eye.sensor
        boards = hand_eye.target[None]
    span = float(np.median(np.linalg.norm(sensors[:1, :3, 3] - boards[:, :3, 3], axis=1))) or 100.0
    space.points(figure, flange[:, :3, 3].T, "flange", size=4, color=style.GREY)
    if run.camera is not None:
        shape = space.pyramid(run.camera, 0.25 * span)
        space.lines(figure, space.moved(sensors, shape), "camera and its field", style.BLUE, 2)
        board = run.board.points[:, [0, run.board.columns - 1, -1, -run.board.columns, 0]].T
        space.lines(figure, space.moved(boards, board), "board", style.ORANGE, 4)
    elif run.is_of_target_poses:
        space.points(figure, sensors[:, :3, 3].T, "camera", size=4, color=style.BLUE)
        axes = 0.1 * span * np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 0], [0, 1, 0]])
        space.lines(figure, space.moved(boards, axes), "target, x and y axis", style.ORANGE, 4)
    elif run.is_of_external_points:
        space.points(figure, sensors[:, :3, 3].T, "instrument", size=4, color=style.BLUE)
        space.points(figure, boards[:, :3, 3].T, "measured point", size=4, color=style.ORANGE)
    else:
        space.points(figure, sensors[:, :3, 3].T, "profiler", size=4, color=style.BLUE)
        space.ball(figure, hand_eye.centre, hand_eye.radius, "ball")
    stalks = np.stack(
        [flange[:, :3, 3], (sensors if hand_eye.kind != TO_HAND else boards)[:, :3, 3]], axis=1
    )
    target = "point" if run.is_of_external_points else "board"
    name = f"flange to {target}" if hand_eye.kind == TO_HAND else "flange to sensor"
    space.lines(figure, stalks, name, style.GREY, 3, ink=True)
    return figure


def _transform(run):
    hand_eye = run.made
    name = "the base" if hand_eye.kind == TO_HAND else "the flange"
    yield words(
        f"Pose of the sensor in the frame of {name}; the rotation is a rotation vector. σ is one standard deviation, "
        "from the noise of the sensor and of the flange poses."
    )
    from workbench.jobs.sensor.hand_eye import placed_json

    placed = placed_json(hand_eye.sensor, hand_eye.covariance)
    rows = [
        (axis, *_valued(v, s), "mm")
        for axis, v, s in zip("xyz", placed["xyz_mm"], placed["std_mm"])
    ]
    rows += [
        (f"r{axis}", *_valued(v, s), "deg")
        for axis, v, s in zip("xyz", placed["rotvec_deg"], placed["rotvec_std_deg"])
    ]
    yield table(["", "value", "σ", "unit"], rows)
    yield from _as_matrix(hand_eye.sensor)
    if run.is_of_external_points:
        yield from _measured_point(hand_eye)
    if run.stated_radius is not None:
        std = hand_eye.std.get("target.radius")
        radius = (
            f"{' ± '.join(_valued(hand_eye.radius, std))} mm, fitted"
            if std
            else f"{rounded(hand_eye.radius, 6)} mm, as certified"
        )
        yield words(f"Radius of the sphere: {radius}.")
        yield from _profiler(run)


def _measured_point(hand_eye):
    """The point on the flange, which is the tool centre point where the tool carries it."""
    yield words("Measured point in the frame of the flange (tool centre point):")
    std = np.sqrt(np.diag(hand_eye.target_covariance))
    values = map(_valued, hand_eye.centre, std)
    rows = [(axis, *value_and_std, "mm") for axis, value_and_std in zip("xyz", values)]
    yield table(["", "value", "σ", "unit"], rows)


def _as_matrix(sensor):
    """The transform as a 4 x 4 matrix and as a quaternion, with digits enough to be copied."""
    yield words("As a matrix that takes sensor coordinates to that frame (translation in mm):")
    rows = [[*(fixed(value, 7) for value in row[:3]), fixed(row[3], 6)] for row in sensor]
    yield table(["", "", "", "mm"], rows, left=0)
    quaternion = Rotation.from_matrix(sensor[:3, :3]).as_quat(canonical=True)
    yield words("Its rotation as a unit quaternion, as ROS orders it:")
    yield table(["qx", "qy", "qz", "qw"], [[fixed(value, 7) for value in quaternion]], left=0)


def _profiler(run):
    """Noise and scale of the profiler and radius of the sphere, with certified and with estimated radius."""
    head = ["", "radius certified", "radius free"]
    rows = []
    solutions = [run.made, run.free] if run.free else [run.made]
    for title, key, values, unit in (
        ("radius of the sphere", "target.radius", [fit.radius for fit in solutions], "mm"),
        (
            "scale error of the profiler’s z (positive: measured too long)",
            "sensor.range_scale",
            [100 * fit.range_scale for fit in solutions],
            "%",
        ),
    ):
        spread = [fit.std.get(key) for fit in solutions]
        spread = [std and (100 * std if unit == "%" else std) for std in spread]
        rows.append(
            (
                title,
                *(
                    f"{' ± '.join(_valued(v, s)) if s else f'{rounded(v, 5)}, held'} {unit}"
                    for v, s in zip(values, spread)
                ),
            )
        )
    rows.append(
        (
            "distance from the sphere, RMS",
            *(f"{rounded(fit.fit['rms_mm'])} mm" for fit in solutions),
        )
    )
    rows.append(("noise of a profile", *(f"{rounded(fit.noise)} mm" for fit in solutions)))
    yield table(head[: 1 + len(solutions)] if run.free else ["", "estimate"], rows)


def _valued(value, std):
    if not std or not np.isfinite(std):
        is_determined = std is None or not np.isinf(std)
        return rounded(value, 5), "–" if is_determined else "not identifiable"
    decimals = decimals_of(std)
    return fixed(value, decimals), fixed(std, decimals)


def _provenance(recording):
    from workbench.files.provenance import provenance

    return [line for line in flat(provenance(recording)) if line[0] != "recording"]
