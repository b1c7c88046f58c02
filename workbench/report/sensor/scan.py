"""Page of scans: point clouds, residuals of the fitted spheres, and acceptance figures by ISO 10360-13."""

from collections.abc import Iterator
from itertools import islice

import numpy as np
import plotly.graph_objects as go

from workbench.jobs.sensor.ball_centres import centres_of, characteristics, whole_covariance
from workbench.jobs.sensor.scan import Ball, Scan, Scans
from workbench.report import style
from workbench.report.sections import Page, Section, figure, note, pair, table, words
from workbench.report.sensor import camera as cameras
from workbench.report.sensor import scanner as scanners
from workbench.report.sensor import space
from workbench.report.text import counted, rounded, sentence

_CLOUDS = 6
_MAPS = 4
_ROWS = 60
_MAX_REMARKS = 12
_NAMED = 6
_MAP_POINTS = 4000


_JOINED = {
    "base": "The images of a scan are joined by flange pose and hand-eye transform: points and centres are in the base "
    "frame of the robot. σ of the JSON holds the errors of light plane, camera, hand-eye transform and flange poses.",
    "turntable": "The images of a scan are joined by the angle of the turntable: points and centres are in the camera "
    "frame at table angle zero. σ of the JSON holds the errors of light plane, camera, axis and angles.",
}


def page(scans: Scans) -> Page:
    """The whole page of `workbench scan`."""
    form, spread, found = _largest_errors(scans)
    numbers = [
        ("form error, RMS, worst sphere", rounded(form), "mm"),
        ("centre, largest 1 σ, best-fit frame", rounded(spread), "mm"),
        ("scans", str(len(scans.scans)), ""),
        ("balls found", str(found), ""),
    ]
    tail = [
        cameras.provenance(
            scans.recording, scans.calibration.camera if scans.calibration else scans
        )
    ]
    scanner_sections = scanners.sections(scans.calibration) if scans.calibration else ()
    return Page(
        "Scans",
        scans.recording.title or scans.recording.name,
        tuple(numbers),
        tuple(lead(scans)),
        (*sections(scans), *scanner_sections, *tail),
    )


def _largest_errors(scans: Scans) -> tuple[float | None, float | None, int]:
    """Largest RMS and 1 sigma of a centre, mm, of completely seen balls (None without one), and their number."""
    form = None
    spread = None
    count = 0
    for _, ball in _found(scans):
        count += 1
        if ball.is_complete:
            form = max(form or 0.0, ball.fit.rms)
            spread = max(spread or 0.0, float(ball.fit.std[:3].max()))
    return form, spread, count


def chain(scans: Scans) -> tuple[Section, ...]:
    """Sensor sections on the page of a calibration from images: scans, and the scanner if it was calibrated here."""
    scanner_sections = scanners.sections(scans.calibration) if scans.calibration else ()
    return (*sections(scans), *scanner_sections)


def sections(scans: Scans) -> tuple[Section, ...]:
    """Sections on the scans."""
    return (
        Section("acceptance", "Acceptance figures", tuple(_acceptance(scans))),
        Section("balls", "Balls", tuple(_balls(scans))),
        Section("clouds", "Clouds", tuple(_clouds(scans))),
    )


def balls_of_scans(scans: Scans) -> Iterator[tuple[Scan, Ball]]:
    """Each ball with its scan."""
    for scan in scans.scans:
        for ball in scan.balls:
            yield scan, ball


def lead(scans: Scans) -> list[str]:
    """Data basis and meaning of the numbers."""
    points = sum(scan.points for scan in scans.scans)
    first = (
        f"{counted(len(scans.scans), 'scan')} with {points:,} points in total; the clouds are PLY files in the folder "
        "of this page. Form error: distance of the points used from the fitted sphere, for the worst of all completely "
        "seen spheres. The radius is the certified one if there is a certificate."
    )
    scanner = (
        "The points are those of the sensor, which has its own calibration."
        if scans.scanner is None
        else "The scanner was calibrated from the same recording; its sections follow below."
        if scans.calibration
        else "The scanner was read from a file."
    )
    centres = centres_of(scans)
    recording_sentence = (
        f" The recording ball-centres holds {counted(centres.n, 'ball centre')} for `workbench calibrate`."
        if centres
        else ""
    )
    return [first, scanner + recording_sentence, *_frames(scans)]


def _frames(scans: Scans) -> list[str]:
    """Reference frames of the standard deviations of centres."""
    joined = sorted({scan.frame for scan in scans.scans} - {"camera"})
    if joined:
        return [_JOINED[name] for name in joined]
    balls = (ball for _, ball in balls_of_scans(scans) if ball.fit)
    if scans.scanner.frame is None:
        return []
    largest_std = max(
        (float(np.sqrt(np.diag(whole_covariance(scans.scanner, ball)).max())) for ball in balls),
        default=None,
    )
    if largest_std is None:
        return []
    return [
        "σ of a centre refers to the frame that fits the scanner's points best; distances between balls and a hand-eye "
        "calibration depend on this σ. In the camera frame, with its error common to all points, σ is up to "
        f"{rounded(1000 * largest_std)} µm. The JSON holds both, std_in_best_frame_mm and std_mm."
    ]


def _acceptance(scans: Scans):
    yield words(
        "Each figure is the largest over the scans. Balls that are cut by the field of view or lie outside the "
        "calibrated depths are excluded. An acceptance test to the standard also requires its artefacts and positions "
        "in the volume. Without a stated limit there is no pass or fail."
    )
    rows = []
    missing = []
    for characteristic in characteristics(scans):
        name = characteristic.name.replace("_", " ")
        if not characteristic.determined:
            missing.append(f"{name}: {characteristic.why}")
            continue
        if characteristic.unit == "1":
            value = 100 * characteristic.value
            unit = "%"
        else:
            value = characteristic.value
            unit = characteristic.unit.replace("deg C", "°C")
        rows.append(
            (
                name,
                characteristic.symbol or "–",
                characteristic.vdi or "–",
                rounded(value),
                "–" if characteristic.std is None else rounded(characteristic.std),
                unit,
                f"{characteristic.n:,}",
            )
        )
    yield table(
        ["characteristic", "ISO 10360-13", "VDI/VDE 2634-2", "value", "σ", "unit", "from values"],
        rows,
        left=3,
    )
    if missing:
        yield note("Not available from these scans", [sentence(line) for line in missing])


_HEAD = (
    *(
        "scan",
        "ball",
        "centre x, y, z (mm)",
        "σx (µm)",
        "σy (µm)",
        "σz (µm)",
        "RMS (µm)",
        "D95 (µm)",
    ),
    *("free radius − certified (µm)", "points used", "cap (deg)"),
)


def _balls(scans: Scans):
    shown = list(islice(_found(scans), _ROWS))  # a long session is not held in memory
    if not shown:
        yield words("No ball was found in any scan.")
        return
    yield table(_HEAD, [_row(scan, ball) for scan, ball in shown], left=3)
    if (others := sum(1 for _ in _found(scans)) - len(shown)) > 0:
        yield words(f"The JSON lists the other {others} balls.", quiet=True)
    remarks, unlisted = _scan_remarks(scans)
    if remarks:
        yield note("Remarks", remarks + [f"The JSON holds {unlisted} more."] * (unlisted > 0))
    residual = 1000 * np.concatenate([ball.fit.residual[ball.fit.inliers] for _, ball in shown])
    scope = ", for the balls of the table" if others > 0 else ""
    caption = f"Distances of all points used from the fitted sphere{scope}."
    yield figure("form", scanners.spread(residual, "µm"), caption)
    yield words(
        "Distances over the balls as seen by the scanner. A pattern common to all balls is due to the light plane or "
        "the surface; a pattern of a single ball is due to that ball."
    )
    maps = [
        figure(
            f"ballmap{k}", ball_map(ball), f"{_called(*scan_and_ball)}: distance from the surface."
        )
        for k, scan_and_ball in enumerate(shown[:_MAPS])
        for ball in scan_and_ball[1:]
    ]
    yield pair(*maps)


def _found(scans: Scans) -> Iterator[tuple[Scan, Ball]]:
    """Each ball that was fitted, with its scan."""
    return ((scan, ball) for scan, ball in balls_of_scans(scans) if ball.fit)


def _called(scan: Scan, ball: Ball) -> str:
    return f"Scan {scan.name}, ball {ball.number or 'unnamed'}"


def _row(scan: Scan, ball: Ball) -> tuple:
    """A row of the table of balls."""
    fit, free, size = ball.fit, ball.free, "–"
    if ball.radius:
        size = f"{1000 * (free.radius - ball.radius):+.1f} ± {1000 * free.std[-1]:.1f}".replace(
            "-", "−"
        )
    centre = ", ".join(f"{v:.4f}".replace("-", "−") for v in fit.centre)
    micrometres = [rounded(1000 * v, 2) for v in fit.std[:3]] + [
        rounded(1000 * v) for v in (fit.rms, fit.d95)
    ]
    return (
        scan.name,
        ball.number or "–",
        centre,
        *micrometres,
        size,
        f"{fit.inliers.sum():,}",
        f"{np.rad2deg(fit.cap):.0f}",
    )


def _scan_remarks(scan_run: Scans) -> tuple[list[str], int]:
    """Remarks on scans and balls, and the number of further ones; a remark common to several scans is given once."""
    same = {}
    odd = []
    known = []
    unlisted = 0
    for scan in scan_run.scans:
        for part in filter(None, scan.outcome.split("; ")):
            if part in same or len(same) < _MAX_REMARKS:
                count, names = same.get(part, (0, []))
                same[part] = count + 1, [*names, scan.name][:_NAMED]
            else:
                unlisted += 1
        for ball in filter(lambda ball: ball.fit, scan.balls):
            if not ball.is_complete and ";" in ball.fit.outcome:
                odd.append(f"{_called(scan, ball)}: {sentence(ball.fit.outcome)}")
            elif ball.is_complete and ball.fit.warnings:
                known.append(f"{_called(scan, ball)}: {sentence('; '.join(ball.fit.warnings))}")
        unlisted += len(odd[_MAX_REMARKS:]) + len(known[_MAX_REMARKS:])
        del odd[_MAX_REMARKS:], known[_MAX_REMARKS:]
    common = [f"{_scans(*scans)}: {sentence(part)}" for part, scans in same.items()]
    remarks = common + odd + known
    return remarks[:_MAX_REMARKS], unlisted + len(remarks[_MAX_REMARKS:])


def _scans(count: int, names: list[str]) -> str:
    """Names of the first few of `count` scans."""
    if count > _NAMED:
        return f"{count} scans, {', '.join(names[: _NAMED - 1])} and more"
    if count == 1:
        return f"Scan {names[0]}"
    return f"Scans {', '.join(names)}"


def ball_map(ball: Ball) -> go.Figure:
    """Residuals (µm) over the ball as seen by the sensor: positions across the line of sight from the centre, mm."""
    used = np.flatnonzero(ball.fit.inliers)
    used = used[np.linspace(0, len(used) - 1, min(len(used), _MAP_POINTS)).astype(int)]
    radial = ball.points[:, used] - ball.fit.centre[:, None]
    values = 1000 * ball.fit.residual[used]
    top = max(float(np.percentile(np.abs(values), 98)), 1e-6)
    plot = style.figure(400, "across, x (mm)", "y (mm)")
    plot.add_scatter(
        x=np.round(radial[0], 3),
        y=np.round(radial[1], 3),
        mode="markers",
        showlegend=False,
        marker=dict(
            size=3,
            color=np.round(values, 2),
            colorscale="RdBu",
            cmin=-top,
            cmax=top,
            showscale=True,
            colorbar=dict(
                title=dict(text="distance (µm)", side="right"), thickness=12, tickformat=".3~g"
            ),
        ),
        hovertemplate="(%{x:.2f}, %{y:.2f}) mm: %{marker.color:.1f} µm<extra></extra>",
    )
    plot.update_xaxes(constrain="domain", zeroline=False)
    return plot.update_yaxes(
        autorange="reversed", scaleanchor="x", constrain="domain", zeroline=False
    )


def _clouds(scans: Scans):
    shown = scans.scans[:_CLOUDS]
    if len(scans.scans) > len(shown):
        yield words(
            f"The first {len(shown)} of {len(scans.scans)} scans, thinned. The PLY files hold all points."
        )
    yield figure(
        "clouds3d",
        scene(shown),
        "Points of the scans and the fitted spheres in the camera frame, mm. Click on a name to hide it.",
    )
    rows = [
        (
            scan.name,
            f"{scan.points:,}",
            f"{sum(scan.dropped.values()):,}",
            len(scan.balls),
            scan.cloud,
        )
        for scan in scans.scans[:_ROWS]
    ]
    yield table(["scan", "points", "stripe centres dropped", "balls", "file"], rows)


def scene(scans) -> go.Figure:
    """Point clouds coloured by depth, with the fitted spheres."""
    plot = space.space(eye=(0.5, -1.3, -1.2))
    plot.layout.scene.camera.up = dict(x=0, y=-1, z=0)
    colours = (style.BLUE, style.ORANGE, style.GREEN, style.VIOLET, style.GREY, "#222222")
    for k, scan in enumerate(scans):
        space.points(
            plot, scan.drawn, f"scan {scan.name}", size=1.6, color=colours[k % len(colours)]
        )
        for ball in scan.balls:
            if ball.fit:
                name = f"ball {ball.number}" if ball.number else "ball"
                space.ball(
                    plot,
                    ball.fit.centre,
                    ball.fit.radius,
                    f"{name} of scan {scan.name}",
                    colours[k % len(colours)],
                )
    return plot
