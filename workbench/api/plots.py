"""Figures of results for notebooks."""

import base64

import numpy as np

_KINDS = ("nominal", "fit", "held_out", "before", "after")


def figure_of(result):
    """A plotly figure of a result: see `workbench.api.results.Result.plot`."""
    import plotly.graph_objects as go

    errors = _errors(result)
    if errors:
        figure = go.Figure()
        for kind, lengths in errors.items():
            ordered = np.sort(lengths)
            share = 100 * np.arange(1, len(ordered) + 1) / len(ordered)
            figure.add_scatter(x=ordered, y=share, name=kind.replace("_", " "), mode="lines")
        figure.update_xaxes(title="3-D error (mm)", type="log")
        figure.update_yaxes(title="share of samples below (%)")
        return figure
    return _summary_image(result)


def _errors(result) -> dict[str, np.ndarray]:
    """Lengths (n,) mm of the residual vectors of each kind that residuals.csv holds."""
    if result.folder is None or not (result.folder / "residuals.csv").exists():
        return {}
    table = result.residuals.to_frame()
    errors = {}
    for kind in _KINDS:
        columns = [f"{kind}_{axis}_mm" for axis in "xyz"]
        if all(column in table for column in columns):
            lengths = np.linalg.norm(table[columns].to_numpy(float), axis=1)
            errors[kind] = lengths[np.isfinite(lengths)]
    return errors


def _summary_image(result):
    """The summary image of the run folder as a figure, or the main table where there is none."""
    import plotly.graph_objects as go

    path = None if result.folder is None else result.folder / "summary.png"
    if path is None or not path.exists():
        return _table(result.to_frame())
    source = "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode()
    figure = go.Figure()
    figure.add_layout_image(
        source=source, x=0, y=1, sizex=1, sizey=1, xref="paper", yref="paper", layer="below"
    )
    figure.update_xaxes(visible=False)
    figure.update_yaxes(visible=False)
    return figure


def _table(frame):
    """A figure with the columns of a DataFrame that hold one number or text a row; numbers with four digits."""
    import plotly.graph_objects as go

    cells = {}
    for name, column in frame.items():
        values = column.tolist()
        if not any(isinstance(value, list | dict) for value in values):
            cells[str(name)] = [f"{v:.4g}" if isinstance(v, float) else v for v in values]
    return go.Figure(
        go.Table(header={"values": list(cells)}, cells={"values": list(cells.values())})
    )
