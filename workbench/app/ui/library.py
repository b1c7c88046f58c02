"""Loads the chart library after the page is on the screen: its script of 4.6 MB would otherwise delay everything."""

import json
from collections.abc import Iterable

_INSTALL = """({install: (app) => app.component('TramePlotly', Vue.defineAsyncComponent(
    () => new Promise((painted) => requestAnimationFrame(() => setTimeout(painted)))
    .then(() => new Promise((resolve, reject) => {
        const script = document.createElement('script');
        script.src = %s;
        script.onload = () => trame_plotly.install({component: (name, made) => resolve(made)});
        script.onerror = () => reject(new Error('The chart library cannot be loaded.'));
        document.body.appendChild(script);
    })))
)})"""
"""A Vue plugin that trame evaluates in the browser: the component is loaded where it is mounted for the first time."""
_PLUGIN = "trame_plotly"


def defer_charts(state) -> None:
    """Take trame's plotly script out of those that are loaded before the page, and load it on demand.

    state: of the server, once all figures are made. trame loads the scripts of all modules before it mounts the page.
    """
    scripts = list(state.trame__scripts)
    charts = next(script for script in scripts if _PLUGIN in script)
    state.trame__scripts = _remaining(scripts, charts)
    plugins = _remaining(state.trame__vue_use, _PLUGIN)
    state.trame__vue_use = [*plugins, _INSTALL % json.dumps(charts)]


def _remaining(items: Iterable, left_out: object) -> list:
    return [item for item in items if item != left_out]
