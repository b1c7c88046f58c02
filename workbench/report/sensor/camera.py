"""The page of a calibrated camera: errors image by image and over the field, and how far each number is known."""

import numpy as np
import plotly.graph_objects as go

from sensors.effects.artefact import BoardBow
from workbench.jobs.camera import CameraRun
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


def page(made: CameraRun) -> Page:
    """The whole page of `workbench camera`."""
    calibration = made.calibration
    held = calibration.held_out
    numbers = [
        ("RMS a coordinate", rounded(calibration.rms_coordinate_px), "px"),
        ("RMS as OpenCV counts", rounded(calibration.rms_px), "px"),
        (
            "focal length",
            _with_sigma(calibration.camera.fx, calibration.std.get("camera.fx")),
            "px",
        ),
    ]
    numbers += [("held out, as OpenCV counts", rounded(held.halved_rms_px), "px")] if held else []
    return Page(
        "Camera calibration",
        made.recording.title or made.recording.name,
        tuple(numbers),
        tuple(lead(made)),
        (*sections(made), provenance(made.recording, made)),
        files=("camera.toml",),
    )


def sections(made: CameraRun, prefix: str = "") -> tuple[Section, ...]:
    """What the page shows of the camera; `prefix` keeps names apart where a page holds more."""
    calibration = made.calibration
    return (
        Section(prefix + "images", "Image by image", tuple(_images(made, prefix))),
        Section(prefix + "field", "Over the field", tuple(_field(calibration, prefix))),
        Section(
            prefix + "known", "How far the camera is known", tuple(_known(calibration, prefix))
        ),
        Section(prefix + "board", "The board", tuple(_board(calibration, prefix))),
        Section(prefix + "camera", "Parameters", tuple(_parameters(calibration))),
    )


def lead(made: CameraRun) -> list[str]:
    """What the numbers mean and on what they rest."""
    calibration = made.calibration
    placed = counted(len(calibration.poses), "placement")
    first = (
        f"RMS distance between corners as the calibrated camera predicts them and as they were found, in "
        f"{counted(len(calibration.views), 'image')} at {placed} of the board, {calibration.view.size:,} corners. "
        "OpenCV counts the distance in two dimensions; that of one coordinate is smaller by √2."
    )
    second = (
        sentence(calibration.held_out.sentence)
        if calibration.held_out
        else ("There are too few placements to leave any out: nothing here is held out.")
    )
    return [first, second]


def _images(made: CameraRun, prefix: str):
    calibration = made.calibration
    count = np.bincount(calibration.view, minlength=len(calibration.views))
    names = [f"{view.image}, {k} corners" for view, k in zip(calibration.views, count)]
    rms = calibration.view_rms_px
    yield figure(
        prefix + "perimage",
        field.bars(names, rms, "RMS distance (px)", rms > 2 * np.median(rms)),
        "RMS distance of each image’s corners, as OpenCV counts. Orange: more than twice the median.",
    )
    yield words(
        "The images with the largest errors: detected corners as circles, arrows from the detected to the predicted "
        "corner."
    )
    yield images(overlays(made))
    if not made.rejected:
        yield words("No image was rejected.")
        return
    yield words(f"{counted(len(made.rejected), 'image')} could not be used:")
    shown = [
        (made.recording.folder / one.image, f"{one.image}: {one.why}")
        for one in made.rejected[:_THUMBNAILS]
    ]
    yield thumbnails(shown)
    if len(made.rejected) > _THUMBNAILS:
        yield words(f"The JSON names the other {len(made.rejected) - _THUMBNAILS}.", quiet=True)


def _field(calibration, prefix: str):
    pixels, residual, size = calibration.chain.pixels, calibration.residual, calibration.camera.size
    arrows, scale = field.arrows(pixels, residual, size)
    share = float((calibration.coverage > 0).mean())
    drawn = style.thinned_sentence(pixels.shape[1]).replace("samples", "corners")
    yield words(
        f"Corners lie in {100 * share:.0f} % of the image’s cells (8 × 6). Where none lie, the lens is "
        f"extrapolated. {drawn}"
    )
    yield pair(
        figure(
            prefix + "coverage",
            field.coverage(pixels, calibration.view, size),
            "Every corner that was used, one colour an image.",
        ),
        figure(
            prefix + "arrows",
            arrows,
            f"Residuals, predicted minus found, enlarged {scale:,.0f} times. Neighbours that "
            "point the same way show what the lens model lacks.",
        ),
    )
    yield words(
        "Means of the residuals in cells of the field. Noise leaves no pattern; a pattern that is larger than "
        "σ/√n of a cell belongs to the lens or to the board."
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


def _known(calibration, prefix: str):
    size, known = calibration.camera.size, calibration.uncertainty
    figures = [
        figure(
            prefix + "sigma",
            _map(known, size, "1 σ"),
            f"Where a point {known.distance_mm:,.0f} mm away projects: 1 σ of the worse direction, from the full "
            "covariance. A camera that is turned in its housing counts as the same camera.",
        )
    ]
    if calibration.halves:
        figures.append(
            figure(
                prefix + "halves",
                _map(calibration.halves.difference, size, "difference"),
                "How far apart two cameras project, each made from every second placement.",
            )
        )
    yield pair(*figures)
    if calibration.halves:
        yield words(sentence(calibration.halves.sentence))
    if calibration.held_out:
        yield _beside_opencv(calibration)
    if calibration.undetermined:
        yield note(
            "What these images do not determine",
            [sentence(line) for line in calibration.undetermined],
        )


def _map(known, size, called):
    return field.heat(known.x, known.y, known.value, size, called)


def _beside_opencv(calibration):
    held = calibration.held_out
    rows = [
        ("pose from all its corners", rounded(held.rms_px), rounded(held.opencv_rms_px)),
        (
            "pose from every second corner, error on the others",
            rounded(held.halved_rms_px),
            rounded(held.opencv_halved_rms_px),
        ),
    ]
    return table(
        [
            f"images left out, {counted(held.folds, 'fold')} (RMS distance, px)",
            "this camera",
            "cv2.calibrateCamera",
        ],
        rows,
    )


def _board(calibration, prefix: str):
    bow = calibration.bow
    if bow is None:
        yield words("The board was taken as flat.")
        return
    height, sigma = rounded(1000 * bow.height_mm), rounded(1000 * bow.height_std_mm)
    yield words(
        f"The board was not taken to be flat: its warp is part of the solve. Highest over lowest point: {height} ± "
        f"{sigma} µm (1 σ). A warp left out shifts the focal length while the RMS hardly changes."
    )
    place, height, std = bow_surface(calibration)
    yield pair(
        figure(
            prefix + "bow",
            _surface(place, height, "height (µm)"),
            "Height of the board over the plane that fits it best.",
        ),
        figure(prefix + "bowsigma", _surface(place, std, "1 σ (µm)"), "1 σ of that height."),
    )
    rows = [
        (f"warp {name}", *_valued(1000 * value, 1000 * bow.std[name]), "µm")
        for name, value in bow.parameters.items()
    ]
    yield table(["height at the corners of the board", "value", "σ", "unit"], rows)


def bow_surface(calibration, across: int = 25):
    """Places x and y (mm), height (rows, columns) over the best plane and its 1 sigma, µm."""
    board = calibration.board
    low, high = board.points.min(1), board.points.max(1)
    x, y = (np.linspace(low[k], high[k], across) for k in (0, 1))
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
    return (x, y), 1000 * height.reshape(across, across), 1000 * std.reshape(across, across)


def _surface(place, values, called) -> go.Figure:
    (x, y), span = place, np.ptp(place[1]) / np.ptp(place[0])
    made = style.figure(int(370 * min(max(span, 0.4), 1.3)) + 90, "x (mm)", "y (mm)")
    made.add_contour(
        x=np.round(x, 2),
        y=np.round(y, 2),
        z=values,
        colorscale="Viridis",
        contours_coloring="heatmap",
        line_width=0.6,
        colorbar=dict(title=dict(text=called, side="right"), thickness=12, tickformat=".3~g"),
        hovertemplate="(%{x:.1f}, %{y:.1f}) mm: %{z:.2f} µm<extra></extra>",
    )
    made.update_xaxes(constrain="domain", zeroline=False)
    return made.update_yaxes(
        autorange="reversed", scaleanchor="x", constrain="domain", zeroline=False
    )


def _parameters(calibration):
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
        "σ is one standard deviation from the full covariance of camera, board and poses, scaled to the residuals; "
        "a value is given to two digits of its σ."
    )
    yield table(["parameter", "what it is", "value", "σ", "unit"], rows, left=2)


def _valued(value: float, std: float | None) -> tuple[str, str]:
    """Value and sigma to two digits of the sigma."""
    if not std or not np.isfinite(std):
        return rounded(value), "–"
    return fixed(value, decimals_of(std)), fixed(std, decimals_of(std))


def _with_sigma(value: float, std: float | None) -> str:
    return " ± ".join(_valued(value, std)) if std else rounded(value, 5)


def provenance(recording, made) -> Section:
    """Where the numbers come from."""
    from workbench.files.provenance import provenance as of

    images = [row["role"] for row in recording.images]
    roles = (
        listed([f"{images.count(role)} {role}" for role in dict.fromkeys(images)])
        if images
        else "–"
    )
    lines = [
        ("recording", recording.name),
        ("measures", recording.measures),
        ("images", roles),
        ("board", board_of(made)),
    ]
    told = {name for name, _ in lines}
    return Section(
        "provenance",
        "Provenance",
        (facts([*lines, *(x for x in flat(of(recording)) if x[0] not in told)]),),
    )


def board_of(made) -> str:
    """What the board is, where there is one."""
    calibration = getattr(made, "calibration", None)
    return calibration.board.title if calibration is not None else ""
