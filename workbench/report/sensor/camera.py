"""Page of a calibrated camera: errors by image and over the field, and the uncertainty of each parameter."""

import numpy as np
import plotly.graph_objects as go

from sensors.effects.artefact import BoardBow
from workbench.jobs.sensor.camera import CameraRun
from workbench.report import style
from workbench.report.provenance import flat
from workbench.report.sections import (
    Page,
    Section,
    facts,
    figure,
    images,
    note,
    pair,
    table,
    thumbnails,
    words,
)
from workbench.report.sensor import field
from workbench.report.sensor.overlays import overlays
from workbench.report.text import counted, decimals_of, fixed, listed, rounded, sentence

_THUMBNAILS = 24


def page(run: CameraRun) -> Page:
    """The whole page of `workbench camera`."""
    calibration = run.calibration
    held_out = calibration.held_out
    numbers = [
        ("RMS reprojection error per coordinate", rounded(calibration.rms_coordinate_px), "px"),
        ("RMS reprojection error (2-D, as in OpenCV)", rounded(calibration.rms_px), "px"),
        (
            "focal length",
            _with_sigma(calibration.camera.fx, calibration.std.get("camera.fx")),
            "px",
        ),
    ]
    if held_out:
        numbers.append(("held-out RMS reprojection error", rounded(held_out.halved_rms_px), "px"))
    return Page(
        "Camera calibration",
        run.recording.title or run.recording.name,
        tuple(numbers),
        tuple(lead(run)),
        (*sections(run), provenance(run.recording, run)),
        files=("camera.toml",),
    )


def sections(run: CameraRun, prefix: str = "") -> tuple[Section, ...]:
    """Sections on the camera; `prefix` makes their names unique on a page with other sections."""
    calibration = run.calibration
    return (
        Section(prefix + "images", "Image by image", tuple(_images(run, prefix))),
        Section(prefix + "field", "Over the field", tuple(_field(calibration, prefix))),
        Section(prefix + "known", "Uncertainty", tuple(_uncertainty(calibration, prefix))),
        Section(prefix + "board", "Board", tuple(_board(calibration, prefix))),
        Section(prefix + "camera", "Parameters", tuple(_parameters(calibration))),
    )


def lead(run: CameraRun) -> list[str]:
    """Meaning and data basis of the numbers."""
    calibration = run.calibration
    poses = counted(len(calibration.poses), "board pose")
    first = (
        f"RMS reprojection error (predicted minus detected corners) in {counted(len(calibration.views), 'image')} at "
        f"{poses}, {calibration.view.size:,} corners. OpenCV states the RMS of the two-dimensional distance, which is "
        "√2 times that of one coordinate."
    )
    second = (
        sentence(calibration.held_out.sentence)
        if calibration.held_out
        else "There are too few board poses for cross-validation: no number is held out."
    )
    return [first, second]


def _images(run: CameraRun, prefix: str):
    calibration = run.calibration
    count = np.bincount(calibration.view, minlength=len(calibration.views))
    names = [f"{view.image}, {k} corners" for view, k in zip(calibration.views, count)]
    rms = calibration.view_rms_px
    yield figure(
        prefix + "perimage",
        field.bars(names, rms, "RMS distance (px)", rms > 2 * np.median(rms)),
        "RMS reprojection distance of the corners of each image. Orange: more than twice the median.",
    )
    yield words(
        "The images with the largest errors: detected corners as circles, arrows from the detected to the predicted "
        "corner."
    )
    yield images(overlays(run))
    if not run.rejected:
        yield words("No image was rejected.")
        return
    yield words(f"{counted(len(run.rejected), 'image')} rejected:")
    shown = [
        (run.recording.folder / rejection.image, f"{rejection.image}: {rejection.why}")
        for rejection in run.rejected[:_THUMBNAILS]
    ]
    yield thumbnails(shown)
    if len(run.rejected) > _THUMBNAILS:
        yield words(f"The JSON lists the other {len(run.rejected) - _THUMBNAILS}.", quiet=True)


def _field(calibration, prefix: str):
    pixels = calibration.chain.pixels
    residual = calibration.residual
    size = calibration.camera.size
    arrows, scale = field.arrows(pixels, residual, size)
    share = float((calibration.coverage > 0).mean())
    drawn = style.thinned_sentence(pixels.shape[1]).replace("samples", "corners")
    yield words(
        f"{100 * share:.0f} % of the cells of the image (8 × 6) contain corners. In the other cells the lens model is "
        f"extrapolated. {drawn}"
    )
    yield pair(
        figure(
            prefix + "coverage",
            field.coverage(pixels, calibration.view, size),
            "All corners used, one colour per image.",
        ),
        figure(
            prefix + "arrows",
            arrows,
            f"Residuals, predicted minus detected, enlarged {scale:,.0f} times. A common direction of neighbouring "
            "residuals indicates a discrepancy of the lens model.",
        ),
    )
    yield words(
        "Mean residuals in cells of the field. Noise has no pattern. A pattern larger than σ/√n of a cell indicates an "
        "unmodelled effect of the lens or the board."
    )
    yield pair(
        figure(
            prefix + "mapu",
            field.residual_map(pixels, residual[0], size, "mean along u"),
            "Mean residual along u.",
        ),
        figure(
            prefix + "mapv",
            field.residual_map(pixels, residual[1], size, "mean along v"),
            "Mean residual along v.",
        ),
    )


def _uncertainty(calibration, prefix: str):
    size = calibration.camera.size
    uncertainty = calibration.uncertainty
    figures = [
        figure(
            prefix + "sigma",
            _map(uncertainty, size, "1 σ"),
            f"1 σ of the projection of a point at {uncertainty.distance_mm:,.0f} mm, in the worse direction, from the "
            "full covariance. A rotation of the camera frame is not counted as an error.",
        )
    ]
    if calibration.halves:
        figures.append(
            figure(
                prefix + "halves",
                _map(calibration.halves.difference, size, "difference"),
                "Difference of the projections of two cameras, each calibrated from every second board pose.",
            )
        )
    yield pair(*figures)
    if calibration.halves:
        yield words(sentence(calibration.halves.sentence))
    if calibration.held_out:
        yield _comparison_with_opencv(calibration)
    if calibration.undetermined:
        yield note(
            "Not identifiable from these images",
            [sentence(line) for line in calibration.undetermined],
        )
    if calibration.notes:
        yield note("Notes", [sentence(line) for line in calibration.notes])


def _map(known, size, called):
    return field.heat(known.x, known.y, known.value, size, called)


def _comparison_with_opencv(calibration):
    held_out = calibration.held_out
    rows = [
        ("pose from all corners", rounded(held_out.rms_px), rounded(held_out.opencv_rms_px)),
        (
            "pose from every second corner, error of the others",
            rounded(held_out.halved_rms_px),
            rounded(held_out.opencv_halved_rms_px),
        ),
    ]
    return table(
        [
            f"held-out images, {counted(held_out.folds, 'fold')} (RMS distance, px)",
            "this camera",
            "cv2.calibrateCamera",
        ],
        rows,
    )


def _board(calibration, prefix: str):
    bow = calibration.bow
    if bow is None:
        yield words("The board is modelled as flat.")
        return
    height, sigma = _valued(1000 * bow.height_mm, 1000 * bow.height_std_mm)
    yield words(
        f"The warp of the board is estimated. Height difference between highest and lowest point: {height} ± "
        f"{sigma} µm (1 σ). An unmodelled warp biases the focal length and hardly changes the RMS."
    )
    place, height, std = bow_surface(calibration)
    yield pair(
        figure(
            prefix + "bow",
            _surface(place, height, "height (µm)"),
            "Height of the board above its best-fit plane.",
        ),
        figure(prefix + "bowsigma", _surface(place, std, "1 σ (µm)"), "1 σ of the height."),
    )
    rows = [
        (f"warp {name}", *_valued(1000 * value, 1000 * bow.std[name]), "µm")
        for name, value in bow.parameters.items()
    ]
    yield table(["height at the corners of the board", "value", "σ", "unit"], rows)


def bow_surface(calibration, point_count: int = 25):
    """Coordinates x and y (mm), height (rows, columns) above the best-fit plane and its 1 sigma, µm."""
    board = calibration.board
    low = board.points.min(1)
    high = board.points.max(1)
    x, y = (np.linspace(low[k], high[k], point_count) for k in (0, 1))
    u, v = (
        (grid.ravel() - middle) / board.half_diagonal
        for grid, middle in zip(np.meshgrid(x, y), board.middle)
    )
    basis = np.stack(
        [{"xx": u * u, "yy": v * v, "xy": u * v}[name] for name in calibration.bow.parameters]
    )
    plane = np.stack([np.ones_like(u), u, v])
    basis = basis - basis @ np.linalg.pinv(plane) @ plane
    index = [
        calibration.fit.table.index[f"artefact.{BoardBow.effect}.{name}"]
        for name in calibration.bow.parameters
    ]
    covariance = calibration.covariance[np.ix_(index, index)]
    height = np.array(list(calibration.bow.parameters.values())) @ basis
    std = np.sqrt(np.einsum("pn,pq,qn->n", basis, covariance, basis))
    return (
        (x, y),
        1000 * height.reshape(point_count, point_count),
        1000 * std.reshape(point_count, point_count),
    )


def _surface(place, values, called) -> go.Figure:
    (x, y) = place
    span = np.ptp(place[1]) / np.ptp(place[0])
    plot = style.figure(int(370 * min(max(span, 0.4), 1.3)) + 90, "x (mm)", "y (mm)")
    plot.add_contour(
        x=np.round(x, 2),
        y=np.round(y, 2),
        z=values,
        colorscale="Viridis",
        contours_coloring="heatmap",
        line_width=0.6,
        colorbar=dict(title=dict(text=called, side="right"), thickness=12, tickformat=".3~g"),
        hovertemplate="(%{x:.1f}, %{y:.1f}) mm: %{z:.2f} µm<extra></extra>",
    )
    plot.update_xaxes(constrain="domain", zeroline=False)
    return plot.update_yaxes(
        autorange="reversed", scaleanchor="x", constrain="domain", zeroline=False
    )


def _models(choice):
    """The models of the lens, compared by their errors on held-out board poses."""
    rows = []
    for row in choice.candidates:
        excess = "–"
        if row.excess is not None:
            excess = f"{100 * row.excess:.2g} ± {100 * row.standard_error:.2g}"
        if row.model == choice.chosen:
            name = f"{row.model} (chosen)"
        else:
            name = row.model
        errors = [
            "–" if value is None else rounded(value) for value in (row.fit_px, row.held_out_px)
        ]
        rows.append((name, str(row.parameters), *errors, excess, str(row.left_out)))
    yield words(sentence(choice.sentence))
    heads = ["lens model", "parameters", "RMS (px)", "held-out RMS (px)"]
    yield table([*heads, "above the best (%)", "corners left out"], rows)


def _parameters(calibration):
    if calibration.choice is not None:
        yield from _models(calibration.choice)
    words_of = {p.key: p for p in calibration.parameters.table}
    rows = []
    for key, value in zip(calibration.parameters.keys, calibration.parameters.values.tolist()):
        name = key.removeprefix("camera.")
        if key.startswith("camera."):
            unit = words_of[key].unit
            rows.append(
                (
                    name,
                    words_of[key].label,
                    *_valued(value, calibration.std.get(key)),
                    "" if unit == "1" else unit,
                )
            )
    yield words(
        "σ is one standard deviation from the full covariance of camera, board and poses, scaled by the residuals. "
        "Values are rounded to two digits of σ."
    )
    yield table(["parameter", "what it is", "value", "σ", "unit"], rows, left=2)


def _valued(value: float, std: float | None) -> tuple[str, str]:
    """Value and sigma, rounded to two digits of sigma."""
    if not std or not np.isfinite(std):
        return rounded(value), "–"
    return fixed(value, decimals_of(std)), fixed(std, decimals_of(std))


def _with_sigma(value: float, std: float | None) -> str:
    if std:
        return " ± ".join(_valued(value, std))
    return rounded(value, 5)


def provenance(recording, calibration_run) -> Section:
    """Section on the provenance of the numbers."""
    from workbench.files.provenance import provenance as of

    images = [row["role"] for row in recording.images]
    if images:
        roles = listed([f"{images.count(role)} {role}" for role in dict.fromkeys(images)])
    else:
        roles = "–"
    lines = [
        ("recording", recording.name),
        ("measures", recording.measures),
        ("images", roles),
        ("board", board_of(calibration_run)),
    ]
    names = {name for name, _ in lines}
    further = [line for line in flat(of(recording)) if line[0] not in names]
    return Section("provenance", "Provenance", (facts([*lines, *further]),))


def board_of(calibration_run) -> str:
    """Title of the calibration board; "" without one."""
    calibration = getattr(calibration_run, "calibration", None)
    return calibration.board.title if calibration is not None else ""
