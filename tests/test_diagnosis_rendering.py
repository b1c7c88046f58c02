"""Every shape that a diagnosis can have is shown: terminal, page, summary image, files and JSON, without exceptions."""

import io
import json

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from rich.console import Console

from workbench.commands.robot.diagnose import show
from workbench.commands.shared import answer
from workbench.diagnosis.linear.problem import Alternative, Finding, Found, Located
from workbench.explanation.minimal_detectable_bias import DetectableBias
from workbench.explanation.output.files import save
from workbench.explanation.result import (
    Control,
    Diagnosis,
    Experiment,
    Proof,
    Step,
    Term,
    Views,
    with_statements,
)
from workbench.explanation.sentences import statements
from workbench.report import style
from workbench.report.diagnosis import figures as figures
from workbench.report.diagnosis.page import page
from workbench.report.diagnosis.summary_image import draw_summary
from workbench.report.page import write_sheet

SAMPLES = 12
ODD = st.sampled_from([0.0, 1e-300, 1e-12, 0.02, 1.0, 1e9, float("inf"), float("nan"), -1.0])
CHANCE = st.sampled_from([0.0, 1e-300, 0.003, 0.5, 0.95, 1.0])
MAYBE = st.none() | ODD
PASSED = st.sampled_from([True, False, None])
FOUND = st.sampled_from(
    [
        ("outliers", "samples", "3 of 12", ()),
        ("noise-heteroscedastic", "noise", "with range_mm", ("range_mm",)),
        ("encoder-quantisation", "joint-2", "", ()),
        ("unknown", "joint-3", "from sample to sample, with nothing that was recorded", ()),
        ("unknown", "base", "a smooth function of q1 and q2", ("q1", "q2")),
        ("joint-compliance", "joint-2", "", ()),
        ("zero-shift", "joint-4", "after 120", ()),
        ("lens-residual", "camera", "", ()),
    ]
)


ALTERNATIVES = st.lists(
    st.builds(
        Alternative,
        st.just("backlash"),
        st.just("joint-2"),
        st.just(""),
        CHANCE,
        ODD,
        st.just("alike"),
    ),
    max_size=2,
)


@st.composite
def terms(draw, kept: bool = True):
    """A term of any kind, whose figures may be zero, infinite or not there."""
    effect, where, label, depends = draw(FOUND)
    figures_of = [draw(CHANCE), draw(CHANCE), draw(ODD), draw(ODD)]
    finding = Finding(effect, where, label, (), *figures_of, depends, tuple(draw(ALTERNATIVES)))
    names = draw(st.lists(st.sampled_from(["cos2", "sin2", "compliance"]), max_size=3, unique=True))
    controls = (Control("permuted", draw(MAYBE), draw(MAYBE), draw(PASSED), 3),)
    return Term(
        finding,
        tuple(_parameter(draw, effect, where, name) for name in names),
        size=draw(MAYBE),
        t=draw(MAYBE),
        t_nested=draw(MAYBE),
        gain=draw(MAYBE),
        reselected_folds=draw(st.integers(0, 9)),
        searched_folds=draw(st.integers(0, 9)),
        controls=controls,
        kept=kept,
        reason="" if kept else "its held-out gain is not significant",
        share=draw(st.none() | CHANCE),
        remainder=draw(st.booleans()),
    )


def _parameter(draw, effect: str, where: str, name: str) -> dict:
    same = {"key": f"{where}.{name}", "name": name, "where": where, "label": name, "effect": effect}
    unit = {"unit": "rad/(N m)", "typical": 1e-5}
    return same | unit | {"value": draw(ODD), "std": draw(ODD), "size_mm": draw(ODD)}


def _proof(draw) -> Proof:
    """Errors that are constant, zero, infinite or growing, in any number of folds."""
    folds = draw(st.integers(1, 5))
    shape = draw(st.sampled_from([np.ones(SAMPLES), np.arange(1.0, SAMPLES + 1)]))
    figures_of = {name: draw(ODD) for name in ("before", "after", "after_same_terms", "t")}
    row = {"folds_by": "blocks of time", "folds": folds, "judges": draw(st.booleans())} | figures_of
    return Proof(
        before=draw(ODD),
        after=draw(ODD),
        fixed=draw(ODD),
        t=draw(ODD),
        folds=folds,
        noise=draw(ODD),
        noise_from="as the recording states",
        errors=np.stack([shape, shape]) * draw(ODD),
        fold=np.arange(SAMPLES) % folds,
        schemes=(row,),
        scheme="blocks of time",
    )


@st.composite
def diagnoses(draw):
    """A diagnosis with any terms, folds, errors, residuals and units."""
    unit = draw(st.sampled_from(["mm", "px"]))
    kept, gone = draw(st.lists(terms(), max_size=3)), draw(st.lists(terms(False), max_size=2))
    places = (Located("joint-2", "joint", ("q2",), draw(CHANCE), draw(CHANCE)),)
    made = Diagnosis(
        "case",
        "A case",
        "external-point" if unit == "mm" else "board-images",
        SAMPLES,
        "geometry",
        unit,
        draw(st.sampled_from(["consistent", "explained", "ambiguous", "unexplained"])),
        tuple(kept),
        tuple(gone),
        places,
        places,
        _proof(draw),
        _visible(draw),
        Experiment("Measure more poses."),
        Found((), None, None, draw(CHANCE), draw(CHANCE), (), (), np.zeros(SAMPLES, bool)),
        draw(st.none() | views(unit)),
        outliers=tuple(draw(st.sampled_from([(), (1, 2), tuple(range(30))]))),
        not_recorded=draw(st.sampled_from([(), ("temperature",)])),
    )
    said = [statements.statement(term, "the reflector", unit) for term in (*kept, *gone)]
    return with_statements(made, said)


@st.composite
def views(draw, unit: str):
    """Residuals and covariates, constant, zero or with gaps."""
    size = 3 if unit == "mm" else 2
    rng = np.random.default_rng(draw(st.integers(0, 3)))
    before = rng.normal(size=(size, SAMPLES)) * draw(st.sampled_from([0.0, 1e-12, 0.1, 1e6]))
    after = before * draw(st.sampled_from([0.0, 1.0]))
    if draw(st.booleans()):
        before[0, ::2] = np.nan
    covariates = {
        "q1": rng.normal(size=SAMPLES),
        "time": np.arange(SAMPLES) * 1.0,
        "tau2": np.full(SAMPLES, 3.0),
    }
    covariates = draw(
        st.sampled_from([covariates, {"time": covariates["time"]}, {"q1": covariates["q1"] * 0}])
    )
    names = ("x", "y", "z") if unit == "mm" else ("u", "v")
    links = rng.normal(size=(3, 8)) if unit == "mm" else None
    steps = (Step("baseline", before), Step("+ backlash at joint-2", after))
    return Views(
        before,
        after,
        rng.normal(size=(size, SAMPLES)),
        covariates,
        ("base", "joint-2"),
        np.arange(SAMPLES),
        links,
        names,
        steps=draw(st.sampled_from([(), steps])) if unit == "mm" else (),
    )


def _visible(draw):
    one = DetectableBias(
        "backlash",
        "joint-2",
        "",
        draw(MAYBE),
        draw(MAYBE),
        draw(CHANCE),
        draw(MAYBE),
        "rad",
        draw(MAYBE),
        draw(MAYBE),
        draw(st.sampled_from(["", "zero-shift"])),
        "joint-2",
    )
    return draw(st.sampled_from([(), (one,)]))


@settings(
    max_examples=20,
    deadline=None,
    suppress_health_check=list(HealthCheck),
    phases=[Phase.explicit, Phase.generate],
)
@given(diagnoses())
def test_every_shape_of_a_diagnosis_is_shown(tmp_path_factory, made):
    folder = tmp_path_factory.mktemp("shown")
    result = json.loads(answer.as_text({**made.as_json(), "run": folder}))
    show(Console(file=io.StringIO(), width=80), result)
    save(made, folder)
    write_sheet(page(made), folder)
    draw_summary(made)
    assert (
        "case" in (folder / "report.html").read_text(encoding="utf-8")
        or (folder / "report.html").stat().st_size
    )


@pytest.mark.parametrize("effect", ["outliers", "noise-heteroscedastic"])
def test_findings_on_the_data_alone_have_no_bar_of_evidence(effect):
    """They explain no chi-square: their gain is 0, and a logarithmic axis has no place for that."""
    term = Term(Finding(effect, "samples", "", (), 1e-9, 1.0, 0.0, 0.0))
    proof = Proof(
        0.1, 0.1, 0.1, 0.0, 5, 0.1, "as the recording states", np.ones((2, 4)), np.zeros(4, int)
    )
    made = Diagnosis(
        "case",
        "A case",
        "external-point",
        4,
        "geometry",
        "mm",
        "explained",
        (term,),
        (),
        (),
        (),
        proof,
        (),
        Experiment("."),
        Found((), None, None, 1.0, 1.0, (), (), np.zeros(4, bool)),
    )
    assert not figures.with_evidence(made)
    assert not list(figures.evidence(made).data[0].y)
    assert page(made)


@pytest.mark.parametrize("low", [0.0, -1.0, 1e-3, np.inf, np.nan])
@pytest.mark.parametrize("high", [0.0, -1.0, 1e-3, 5.0, np.inf, np.nan])
def test_a_logarithmic_axis_has_finite_ends_whatever_it_is_given(low, high):
    axis = style.log_axis(low, high)
    assert np.isfinite(axis["range"]).all() and axis["range"][0] < axis["range"][1]
    assert len(axis["tickvals"]) == len(axis["ticktext"]) > 0
