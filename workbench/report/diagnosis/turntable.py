"""The section on a turntable: error of each angle, the law that is retained, and its tests."""

import numpy as np

from sensors.scanner.turntable_calibration import TurntableCalibration
from workbench.report import style
from workbench.report.sections import Section, figure, note, table
from workbench.report.text import p_value, rounded


def section(turntable: TurntableCalibration) -> Section:
    """Angle errors of the positions, the terms of the law, and the leave-one-out errors."""
    return Section("turntable", "Angles of the turntable", tuple(_blocks(turntable)))


def _blocks(turntable: TurntableCalibration):
    yield figure("turntable", _errors(turntable), _caption(turntable))
    yield note("What was found", turntable.sentences)
    rows = [
        (term.name, p_value(term.probability), "yes" if term.retained else "no")
        for term in turntable.terms
    ]
    if rows:
        yield table(["term of the angle law", "p of its F-test", "retained"], rows)


def _errors(turntable: TurntableCalibration):
    drawn = style.figure(360, "commanded angle (deg)", "angle error (deg)")
    commanded = np.rad2deg(turntable.commanded)
    measured = np.rad2deg(turntable.measured - turntable.commanded)
    drawn.add_scatter(
        x=commanded,
        y=measured,
        mode="markers",
        name="measured, 1 σ",
        marker_color=style.BLUE,
        error_y=dict(type="data", array=np.rad2deg(turntable.sigma), thickness=1),
    )
    law = measured - np.rad2deg(turntable.residual)
    drawn.add_scatter(x=commanded, y=law, mode="lines", name="angle law", line_color=style.ORANGE)
    return drawn


def _caption(turntable: TurntableCalibration) -> str:
    before, after = np.rad2deg([turntable.before, turntable.after])
    return (
        f"Error of each position of the table. Leave-one-out RMS error {rounded(before)} deg as commanded, "
        f"{rounded(after)} deg with the angle law."
    )
