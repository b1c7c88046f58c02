"""Page of a calibrated scanner: light planes and mirror in space, residuals of the stripes, and the camera."""

import numpy as np
import plotly.graph_objects as go

from workbench.core.least_squares.adjustment_tests import p_text
from workbench.jobs.sensor.scanner import ScannerRun
from workbench.report import style
from workbench.report.sections import Page, Section, figure, note, pair, table, words
from workbench.report.sensor import camera as cameras
from workbench.report.sensor import field, space
from workbench.report.text import counted, rounded, sentence

_MOST_ROWS = 24


def page(run: ScannerRun) -> Page:
    """The whole page of `workbench scanner`."""
    calibration = run.calibration
    good = ~calibration.wrong
    numbers = [
        (
            "stripe points from their planes, RMS",
            rounded(_rms(calibration.residual_mm[good])),
            "mm",
        ),
        ("along the scan line", rounded(calibration.sigma_stripe_px), "px"),
    ]
    if calibration.left_out:
        numbers.append(("held-out board poses", rounded(calibration.left_out.rms_mm), "mm"))
    numbers.append(("corners, per coordinate", rounded(calibration.sigma_corner_px), "px"))
    return Page(
        "Scanner calibration",
        run.recording.title or run.recording.name,
        tuple(numbers),
        tuple(lead(run)),
        (*sections(run), cameras.provenance(run.recording, run.camera)),
        files=("scanner.toml",),
    )


def sections(run: ScannerRun) -> tuple[Section, ...]:
    """Sections on the light planes, then on the camera (from its corners only)."""
    calibration = run.calibration
    return (
        Section("planes", "Light planes", tuple(_planes(calibration))),
        Section("stripes", "Residuals of the stripes", (*_stripes(calibration), *_rejected(run))),
        Section("mirror", "Mirror model", tuple(_mirror(calibration))),
        Section("leftout", "Held-out board poses", tuple(_left_out(calibration))),
        *cameras.sections(run.camera, "camera-"),
    )


def lead(run: ScannerRun) -> list[str]:
    """Adjusted quantities and their data basis."""
    calibration = run.calibration
    if calibration.scanner.mirror is not None:
        kind = "one mirror model for all planes"
    else:
        kind = (
            "an independent light plane for every step"
            if len(calibration.scanner.steps) > 1
            else "one light plane"
        )
    points, low, high = int((~calibration.wrong).sum()), *calibration.volume
    board_poses = len(np.unique(calibration.made.board_stripes.labels["placement"]))
    first = (
        f"Distance of {points:,} points of the laser stripe, seen on the board at "
        f"{counted(board_poses, 'board pose')}, from their light "
        "planes. "
        f"Camera, warp and poses of the board, and {kind} are adjusted jointly, with all residuals in pixels, at "
        f"{low:.0f} to {high:.0f} mm from the camera."
    )
    return [first, *(sentence(calibration.left_out.sentence) for _ in (1,) if calibration.left_out)]


def rejected_points(found, size: tuple[int, int]):
    """Image of the points of the laser line that were left out, with the region that holds most of them."""
    if found is None or found.wrong is None or not found.wrong.any():
        return
    text = f"Points of the laser line on boards: {100 * found.share:.1f} % were left out as wrong."
    if found.region:
        text += f" They depend on the {found.called}: {found.region}."
    yield figure("rejected-points", field.rejected(found.pixels, found.wrong, size), text)


def _rejected(run: ScannerRun):
    """Laser images that were excluded, by reason, and remarks on the adjustment."""
    yield from rejected_points(run.calibration.rejected, run.calibration.camera.size)
    by_reason: dict[str, list[str]] = {}
    for rejection in run.rejected:
        by_reason.setdefault(rejection.why, []).append(rejection.image)
    if by_reason:
        yield note(
            "Excluded laser images",
            [
                f"{counted(len(names), 'image')} ({', '.join(names[:6])}{' …' * (len(names) > 6)}): {why}."
                for why, names in by_reason.items()
            ],
        )
    yield note(
        "Exclusions, and content of the standard deviations",
        [sentence(line) for line in run.calibration.sentences],
    )


def _rms(values) -> float:
    if values.size:
        return float(np.sqrt((values**2).mean()))
    return float("nan")


def _planes(calibration):
    scanner = calibration.scanner
    yield figure(
        "space3d",
        scene(calibration),
        "Camera, its field and the light planes between the nearest and the "
        "farthest "
        "board. Drag to rotate.",
    )
    chosen = np.unique(
        np.linspace(0, len(scanner.steps) - 1, min(len(scanner.steps), _MOST_ROWS)).astype(int)
    )
    if len(chosen) < len(scanner.steps):
        yield words(
            f"{len(chosen)} of {len(scanner.steps)} planes. scanner.toml and the JSON hold all.",
            quiet=True,
        )
    head = ["step", "nx", "ny", "nz", "offset (mm)", "RMS (mm)", "RMS (px)", "1 σ (mm)"]
    sigma = calibration.sigma_stated_mm
    alone = sigma is calibration.sigma_plane_mm
    rows = [
        (
            str(scanner.steps[k]),
            *(f"{n:.6f}".replace("-", "−") for n in scanner.planes[:3, k]),
            f"{scanner.planes[3, k]:.4f}".replace("-", "−"),
            rounded(calibration.rms_mm[k]),
            rounded(calibration.rms_px[k]),
            rounded(sigma[k]),
        )
        for k in chosen
    ]
    yield table(head, rows)
    yield words(
        "A plane is n·X + b = 0 in the camera frame. RMS: distances of its points. 1 σ: uncertainty of the plane over "
        f"the working volume, in the {'camera frame' if alone else 'best-fit frame'}.",
        quiet=True,
    )
    if len(scanner.steps) > 1:
        yield figure(
            "persteps",
            per_step(calibration),
            "RMS distance of the points of each step from their plane, and 1 σ of the plane.",
        )


def scene(calibration) -> go.Figure:
    """Camera, boards, light planes and mirror axis, camera frame, mm."""
    scanner = calibration.scanner
    plot = space.space(eye=(0.4, -1.5, -1.3))
    low, high = calibration.volume
    scene = plot.layout.scene
    scene.camera.up = dict(x=0, y=-1, z=0)  # the camera's y points down
    space.lines(
        plot, space.pyramid(scanner.camera, high)[None], "camera and its field", style.BLUE, 2
    )
    board = calibration.start.board
    rim = board.points[:, [0, board.columns - 1, -1, -board.columns, 0]].T
    paths = space.moved(_poses(calibration.poses), rim)
    space.lines(plot, paths, "boards", style.GREY, 2)
    space.light_planes(
        plot, space.patches(scanner.planes, scanner.camera, low, high), "light planes"
    )
    if scanner.mirror is not None:
        axis = scanner.mirror.point[:, None] + np.outer(
            scanner.mirror.axis, [-0.25 * high, 0.25 * high]
        )
        space.lines(plot, axis.T[None], "axis of the mirror", style.VIOLET, 6)
    return plot


def _poses(values):
    from workbench.core.rigid import rotation_matrix, transform

    return transform(rotation_matrix(values[:, 3:]), values[:, :3])


def per_step(calibration) -> go.Figure:
    """RMS of the points and sigma of the plane over the step."""
    plot = style.figure(340, "mirror step", "distance (mm)")
    for name, values, colour in (
        ("RMS of its points", calibration.rms_mm, style.BLUE),
        ("1 σ of the plane", calibration.sigma_stated_mm, style.ORANGE),
    ):
        plot.add_scatter(
            x=calibration.scanner.steps,
            y=values,
            mode="lines+markers",
            name=name,
            line=dict(color=colour, width=2),
            marker_size=5,
            hovertemplate="step %{x}: %{y:.5f} mm<extra>" + name + "</extra>",
        )
    return plot.update_yaxes(rangemode="tozero")


def _stripes(calibration):
    good = ~calibration.wrong
    pixels = calibration.stripes.pixels[:, good]
    size = calibration.camera.size
    residual = calibration.residual_px[good]
    step = calibration.stripes.labels["step"][good]
    yield words(
        "Stripe minus light plane, along the scan line. A pattern over the image indicates a curved light plane or an "
        "unmodelled lens effect; a deviating step indicates a mirror error."
    )
    steps = calibration.scanner.steps
    figures = [
        figure(
            "stripemap",
            field.residual_map(pixels, residual, size, "mean residual"),
            "Mean residual over the image.",
        )
    ]
    if len(steps) > 1:
        figures.append(
            figure(
                "stripestep",
                over_step(step, residual, steps),
                "Residuals over the step: mean, and the band from the 16th to the 84th percentile.",
            )
        )
    figures.append(
        figure(
            "stripehist",
            spread(residual),
            "Distribution of the residuals, and the normal distribution of the same RMS.",
        )
    )
    yield pair(*figures[:2])
    yield from figures[2:]
    if calibration.dropped:
        rows = [(why, f"{number:,}") for why, number in calibration.dropped.items() if number]
        if rows:
            yield table(["excluded stripe points", "points"], rows)


def over_step(step: np.ndarray, residual: np.ndarray, steps: np.ndarray) -> go.Figure:
    """Mean residual (px) of the points of each step, and the band from the 16th to the 84th percentile."""
    order = np.argsort(step, kind="stable")
    residuals_of_steps = np.split(
        residual[order], np.cumsum(np.bincount(step, minlength=len(steps)))[:-1]
    )
    low, mean, high = np.array(
        [
            [*np.percentile(p, [16]), p.mean(), *np.percentile(p, [84])] if p.size else [np.nan] * 3
            for p in residuals_of_steps
        ]
    ).T
    plot = style.figure(380, "mirror step", "residual (px)")
    plot.add_scatter(
        x=np.concatenate([steps, steps[::-1]]),
        y=np.concatenate([high, low[::-1]]),
        fill="toself",
        fillcolor="rgba(31,131,196,0.2)",
        line_width=0,
        name="two thirds of the points",
        hoverinfo="skip",
    )
    plot.add_scatter(
        x=steps,
        y=mean,
        mode="lines+markers",
        name="mean",
        line=dict(color=style.BLUE, width=2),
        marker_size=4,
        hovertemplate="step %{x}: mean %{y:.4f} px<extra></extra>",
    )
    return plot


def spread(residual: np.ndarray, unit: str = "px") -> go.Figure:
    """Histogram of residuals within 5 robust sigmas, and the normal curve of their RMS."""
    sigma = _rms(residual)
    counts, edges = np.histogram(residual, bins=np.linspace(-5, 5, 81) * sigma)
    plot = style.figure(330, f"residual ({unit})", "points")
    middle = (edges[1:] + edges[:-1]) / 2
    plot.add_bar(
        x=middle,
        y=counts,
        width=np.diff(edges),
        marker=dict(color=style.BLUE, line_width=0),
        showlegend=False,
        hovertemplate="%{x:.4f} " + unit + ": %{y}<extra></extra>",
    )
    curve = (
        np.exp(-((middle / sigma) ** 2) / 2)
        * residual.size
        * np.diff(edges)
        / (sigma * np.sqrt(2 * np.pi))
    )
    plot.add_scatter(
        x=middle,
        y=curve,
        mode="lines",
        name=f"normal, σ = {rounded(sigma)} {unit}",
        line=dict(color=style.ORANGE, width=2),
        hoverinfo="skip",
    )
    return plot


def _mirror(calibration):
    check = calibration.mirror
    if check is None:
        yield words(
            "The planes are independent: there are too few steps for a mirror model, or none was requested."
        )
        return
    yield words(
        f"The mirror model generates all planes from one light plane and one rotating mirror: "
        f"{len(check.fitted)} numbers instead of "
        f"{3 * len(calibration.scanner.steps)}. Independent planes differ from it by "
        f"{rounded(check.difference_mm)} mm RMS over the working volume; expected from their standard deviations: "
        f"{rounded(check.expected_mm)} mm. Lack-of-fit test of the mirror model: "
        f"{p_text(check.probability)}, {check.verdict}."
    )
    yield figure(
        "mirrorcheck",
        against_free(calibration),
        "Distance between each independent plane and that of the mirror model, RMS over the working volume.",
    )
    mirror = check.mirror
    vectors = {
        "axis": mirror.axis,
        "a point of it (mm)": mirror.point,
        "normal of the face at angle 0": mirror.face,
        "light plane before the mirror, normal": mirror.beam[:3],
    }
    rows = [
        (name, *(f"{v:.5f}".replace("-", "−") for v in vector)) for name, vector in vectors.items()
    ]
    yield table(["mirror, frame of the camera", "x", "y", "z"], rows)
    if check.sentences:
        yield note(
            "Mirror parameters that are not identifiable",
            [sentence(line) for line in check.sentences],
        )


def against_free(calibration) -> go.Figure:
    """Distance between the independent plane and that of the mirror model at each step, mm."""
    plot = style.figure(320, "mirror step", "distance of the planes (mm)")
    plot.add_bar(
        x=calibration.scanner.steps,
        y=calibration.mirror.difference_of_step_mm,
        marker=dict(color=style.BLUE, line_width=0),
        showlegend=False,
        hovertemplate="step %{x}: %{y:.5f} mm<extra></extra>",
    )
    return plot.update_layout(bargap=0.15)


def _left_out(calibration):
    held_out = calibration.left_out
    if held_out is None:
        yield words("There are too few board poses for cross-validation.")
        return
    yield words(
        sentence(held_out.sentence) + " The pose of a held-out board comes from its corners only."
    )
    known = np.isfinite(held_out.placement_rms_mm)
    names = [
        f"board pose {name}" for name, is_known in zip(calibration.placements, known) if is_known
    ]
    yield figure(
        "leftoutbars",
        field.bars(
            names,
            held_out.placement_rms_mm[known],
            "RMS of all its points (mm)",
            x_title="board pose with laser images",
        ),
        "Stripes of each board pose, relative to planes that were estimated without them.",
    )
