"""The measuring chain as a row of places, with the share of the model discrepancy at each."""

import numpy as np
import plotly.graph_objects as go

from workbench.core.vocabulary import Place
from workbench.explanation.result import Diagnosis
from workbench.explanation.sentences import words as said
from workbench.report import style

_OUTSIDE_CHAIN = ("time", "noise", "samples")
_DISTANCE_APART = 3.0  # between places outside the chain, so that the names of their findings fit
_SMALL = 13
_LARGE = 46


def chain(diagnosis: Diagnosis) -> go.Figure:
    """Joints and links in a row from the base to sensor and target; places outside the chain below."""
    places = places_of(diagnosis)
    row = [where for where in places if where not in _OUTSIDE_CHAIN]
    share = {where: share_at(diagnosis, where) for where in places}
    x, y = _where(row, [where for where in places if where in _OUTSIDE_CHAIN])
    drawn = style.figure(350)
    _line(drawn, x, y, row)
    _marks(drawn, places, x, y, share)
    _names(drawn, diagnosis, places, x, y)
    drawn.update_xaxes(visible=False, range=[-0.7, max(x.values()) + 0.7])
    drawn.update_yaxes(visible=False, range=[-1.75, 1.5])
    return drawn.update_layout(margin=dict(l=8, r=8, t=8, b=8), showlegend=False)


_SHORT = {"joint": "J", "link": "L", "ball": "ball "}


def places_of(diagnosis: Diagnosis) -> list[str]:
    """Places of the chain in order, and further places with a finding."""
    known = list(diagnosis.views.chain) if diagnosis.views else []
    of_findings = _places_of_findings(diagnosis)
    balls = sorted(where for where in of_findings if Place.of(where).kind == "ball")
    others = [where for where in of_findings if where not in known and where not in balls]
    return [*known, *balls, *others]


def _places_of_findings(diagnosis: Diagnosis) -> list[str]:
    """Each place with a located residual or a finding once."""
    located = [located.where for located in diagnosis.located]
    terms = [term.finding.where for term in diagnosis.terms]
    return list(dict.fromkeys([*located, *terms]))


def share_at(diagnosis: Diagnosis, where: str) -> float:
    """Share of the model discrepancy that originates at a place; 0 if it is not significant."""
    return max(
        (
            located.share
            for located in diagnosis.located
            if located.where == where and located.p_value < 0.01
        ),
        default=0.0,
    )


def _where(row, separate):
    x = {where: float(k) for k, where in enumerate(row)}
    x |= {where: _DISTANCE_APART * k for k, where in enumerate(separate)}
    y = dict.fromkeys(row, 0.0) | dict.fromkeys(separate, -1.1)
    return x, y


def _line(drawn, x, y, row):
    drawn.add_scatter(
        x=[x[w] for w in row],
        y=[y[w] for w in row],
        mode="lines",
        hoverinfo="skip",
        meta="ink",
        line=dict(color=style.GREY, width=5),
    )


def _marks(drawn, places, x, y, share):
    values = np.array([share[w] for w in places])
    drawn.add_scatter(
        x=[x[w] for w in places],
        y=[y[w] for w in places],
        mode="markers",
        marker=dict(
            size=_SMALL
            + (_LARGE - _SMALL) * np.sqrt(values / max(values.max(initial=0), 1e-9)) * (values > 0),
            color=100 * values,
            colorscale=[[0, "#d5d5d5"], [0.05, "#f4c27a"], [1, "#c63a10"]],
            cmin=0,
            cmax=max(100 * float(values.max(initial=0)), 1.0),
            line=dict(color=style.GREY, width=1),
            symbol=["square" if Place.of(w).kind == "link" else "circle" for w in places],
        ),
        customdata=[
            f"{said.place(w)}: {100 * share[w]:.0f} % of the model discrepancy" for w in places
        ],
        hovertemplate="%{customdata}<extra></extra>",
    )
    drawn.add_scatter(
        x=[x[w] for w in places],
        y=[y[w] - 0.42 for w in places],
        mode="text",
        hoverinfo="skip",
        text=[_short(w) for w in places],
        textfont=dict(size=11),
    )
    labels = [f"{100 * share[w]:.0f} %" if share[w] else "" for w in places]
    drawn.add_scatter(
        x=[x[w] for w in places],
        y=[y[w] - 0.62 for w in places],
        mode="text",
        hoverinfo="skip",
        text=labels,
        textfont=dict(size=10),
    )


def _short(where: str) -> str:
    place = Place.of(where)
    if place.number is None:
        return where
    return f"{_SHORT.get(place.kind, place.kind)}{place.number}"


def side(x: float, first: float, last: float) -> str:
    """Anchor of a label, chosen so that one at an end of the chain stays in the figure."""
    share = (x - first) / max(last - first, 1e-9)
    return "left" if share < 0.05 else "right" if share > 0.95 else "center"


def _names(drawn, diagnosis, places, x, y):
    """Names of the findings: above their places, to the right of those outside the chain."""
    names_by_place: dict[str, list] = {}
    for term in diagnosis.terms:
        names_by_place.setdefault(term.finding.where, []).append(term.finding.effect)
    for k, where in enumerate(w for w in places if w in names_by_place):
        text = "<br>".join(dict.fromkeys(names_by_place[where]))
        blue = dict(size=11, color=style.BLUE)
        if where in _OUTSIDE_CHAIN:
            drawn.add_annotation(
                x=x[where] + 0.3,
                y=y[where],
                text=f"<b>{text}</b>",
                showarrow=False,
                xanchor="left",
                font=blue,
            )
            continue
        drawn.add_annotation(
            x=x[where],
            y=y[where] + 0.22,
            text=f"<b>{text}</b>",
            showarrow=True,
            arrowhead=0,
            ax=0,
            xanchor=side(x[where], min(x.values()), max(x.values())),
            ay=-36 - 34 * (k % 3),
            font=blue,
            arrowcolor=style.BLUE,
        )
