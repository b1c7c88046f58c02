"""Maps of the robot error over the workspace, nominal and calibrated, for one repeated run of a study."""

from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from robot_model.chain import forward
from workbench.core.errors import InputError
from workbench.report.calibration.scene import axes
from workbench.report.calibration.volume import write_volume
from workbench.report.sections import figure, image, pair, words
from workbench.studies import robots
from workbench.studies.runs import seed_of
from workbench.studies.spec import Study
from workbench.studies.variation import values_of, with_values

_POSES = 1200


def blocks(study: Study, folder: Path):
    """Maps of the error over the workspace under the last load: uncalibrated, or nominal and each model.

    Writes the volume of the first model into the folder, as an image and a file for ParaView.
    """
    run_study = with_values(study, values_of(study, 1))
    test_samples = run_study.test.model_copy(update={"samples": _POSES})
    changed = run_study.model_copy(update={"test": test_samples, "tasks": None})
    try:
        world = robots.world(changed, seed_of(study, 1))
        calibrated = "calibrate" in run_study.do
        calibrations = robots.calibrations(run_study, world.measured) if calibrated else {}
    except InputError:
        return
    name, test = list(world.tests.items())[-1]
    errors = _errors(world, calibrations, test)
    robot = world.truth.model.chain.robot
    places = _places(robot, test)
    load = name.removeprefix("test").strip("_").replace("_", ", ") or "the scene's loads"
    yield words(
        f"Run 1, repeated at {_POSES:,} further poses under {load}: flange position of each pose in the "
        "robot's root frame, coloured by the error. Each map has its own colour scale."
    )
    first, error = errors[min(1, len(errors) - 1)]
    drawn = write_volume(places, np.linalg.norm(error, axis=0), _arm(robot), folder, "workspace")
    if drawn:
        yield image(
            drawn,
            f"{first}: error over the workspace, cut open around the arm with all joints at zero. "
            "Open workspace.vti from the same folder in ParaView.",
        )
    distances = [(title, np.linalg.norm(error, axis=0)) for title, error in errors]
    shown = [
        figure(
            f"map{k}",
            error_map(places, distance),
            f"{title}: RMS {np.sqrt((distance**2).mean()):.3f} mm.",
        )
        for k, (title, distance) in enumerate(distances)
    ]
    for k in range(0, len(shown), 2):
        yield pair(*shown[k : k + 2]) if len(shown[k : k + 2]) == 2 else shown[k]


def _errors(world, calibrations, test):
    """Title and (3, n) errors of each model."""
    if not calibrations:
        return [("Uncalibrated", robots.believed(world.truth, test))]
    first = next(iter(calibrations.values()))
    errors = [("Nominal, base and tool fitted", robots.nominal_residual(first, test))]
    for name, calibration in calibrations.items():
        errors.append((f"After {name}", robots.residual_of(calibration, test)))
    return errors


def _places(robot, test) -> np.ndarray:
    """(3, n) flange of the nominal robot, root frame, mm."""
    return forward(robot, robot.mixing @ test.joints.T).end_origin


def _arm(robot) -> np.ndarray:
    """(3, k) base, joint origins and flange of the nominal arm with its joints at zero, mm."""
    frames = forward(robot, np.zeros((robot.joints, 1)), links=True)
    return np.vstack(
        [frames.pivot[:1, :, 0], frames.origin[:, :, 0], frames.end_origin[None, :, 0]]
    ).T


def error_map(places: np.ndarray, distance: np.ndarray) -> go.Figure:
    """Points in space coloured by their error."""
    plot = go.Figure(
        layout=dict(template="none", height=460, margin=dict(l=0, r=0, t=8, b=0), scene=axes())
    )
    x, y, z = np.round(places, 2)
    bar = dict(
        title=dict(text="error (mm)", side="right"), thickness=12, len=0.7, x=1.0, xanchor="right"
    )
    plot.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="markers",
        showlegend=False,
        customdata=np.round(distance, 5),
        marker=dict(
            size=3,
            color=np.round(distance, 5),
            colorscale="Viridis",
            cmin=0,
            cmax=float(np.percentile(distance, 98)),
            colorbar=bar,
        ),
        hovertemplate="%{customdata:.4f} mm<br>(%{x:.0f}, %{y:.0f}, %{z:.0f}) mm<extra></extra>",
    )
    plot.update_layout(scene_aspectmode="data")
    return plot
