"""Laws that poses hardly distinguish: shared first moments, laws that are confounded in any poses, uncertain sizes."""

import numpy as np
import pytest

from robot_model.effects import CATALOGUE, unknown_masses
from scenes import ABB, CRAIG, model_of, scene
from test_diagnosis_engine import recorded
from test_real_arm_effects import without_masses
from workbench.diagnosis.linear.estimates import with_variation
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.robot.shared_moments import with_shared_moments
from workbench.diagnosis.search.findings import _explains_more
from workbench.diagnosis.search.posterior import is_law_of_function
from workbench.diagnosis.search.select import find, found_terms


def law(name, where, **options):
    return CATALOGUE[name](where, **options)


@pytest.mark.parametrize("sag", [0.0, 30.0])
@pytest.mark.parametrize("arm", [ABB, CRAIG], ids=["abb", "craig"])
def test_moments_of_one_joint_make_the_torque_of_those_beyond_it(arm, sag):
    """However they are divided between the bars and what differs from them."""
    chain = model_of(scene("external-point", n=60, arm=arm, seed=4)).chain
    torque = chain.state.self_torque
    two = law("gravity-compliance", "joint-2")
    columns = two.basis(chain.state)[:, 0].T
    rest = np.linalg.lstsq(columns[:, 1:], torque[1] - sag * columns[:, 0], rcond=None)[0]
    for number in (3, 4, 5):
        other = law("gravity-compliance", f"joint-{number}")
        values = other.moments_of(two, chain) @ np.concatenate([[sag], rest])
        made = values @ other.basis(chain.state)[:, 0]
        own = torque[number - 1]
        scale = made @ own / (own @ own)
        assert scale > 0
        assert np.abs(made - scale * own).max() < 1e-6 * np.abs(made).max()


def test_once_a_joint_deflects_another_one_has_one_unknown_and_the_true_torque():
    """The law of joint 3 alone has nine unknowns; what it makes then is what the true masses make."""
    deflecting = [law("joint-compliance", f"joint-{k}") for k in (2, 3)]
    recording = recorded(31, deflecting, [1e-5, 1.4e-5])
    bench = bench_of(without_masses(recording))
    plain = bench.problem([])
    assert with_shared_moments(plain, bench.chain) is plain
    problem = with_shared_moments(
        bench.problem([law("gravity-compliance", "joint-2")]), bench.chain
    )
    assert problem.moments_cost > 0
    bare = problem.conditional_on(())
    own = {c.key: c for c in problem.candidates}
    stated = {c.key: c for c in bench_of(recording).problem([]).candidates}
    for number in (2, 3):
        made = own["candidate", "gravity-compliance", f"joint-{number}", ""].columns
        true = stated["candidate", "joint-compliance", f"joint-{number}", ""].columns
        assert made.shape[1] == 1
        one, other = (bare.orthogonalise(c[:, 0]) for c in (made, true))
        assert one @ other > 0.98 * np.sqrt((one @ one) * (other @ other))


def test_weak_compliances_next_to_error_curves_are_no_first_harmonic():
    """Shared moments with a wider prior than other laws cost more than a harmonic, which predicts worse by a sixth."""
    rng = np.random.default_rng(2)
    compliances = {2: 2.8e-6, 3: 4.9e-6, 4: 1.4e-5, 5: 2.1e-5}
    effects = [law("joint-compliance", f"joint-{k}") for k in compliances]
    values = [size * rng.uniform(0.6, 1.6) for size in compliances.values()]
    for number in (3, 6):
        effects.append(law("joint-curve", f"joint-{number}", start=-1.5, end=1.5, terms=15))
        values += list(rng.normal(size=15) * 4e-4 / np.arange(1, 16))
    recording = recorded(7002, effects, values, n=150, sigma=0.03)
    found = {f.effect for f in found_terms(bench_of(without_masses(recording)))}
    assert found == {"joint-curve", "gravity-compliance"}


def test_a_first_harmonic_may_be_a_spring():
    """A spring between two links pulls with a lever that is nearly a sine of the angle."""
    effects = [law("transmission-harmonic", "joint-3", order=1)]
    (found,) = find(bench_of(recorded(33, effects, [2e-4, -3e-4]))).findings
    spring = next(a for a in found.alternatives if a.effect == "joint-torque")
    assert (found.effect, found.where) == ("transmission-harmonic", "joint-3")
    assert spring.where == "joint-3"
    assert spring.probability == pytest.approx(found.probability)
    assert found.probability + spring.probability > 0.95


@pytest.mark.parametrize("gain, is_same", [(99.5, True), (98.0, False)])
def test_an_error_curve_is_any_function_of_its_own_angle(gain, is_same):
    """The two differ by their bases alone, so that the function is no other explanation."""
    curve = law("joint-curve", "joint-5", start=-1.0, end=1.0)
    named = Hypothesis("joint-curve", "joint-5", "of 7 terms", effects=(curve,), gain=gain)
    function = Hypothesis("unknown", "joint-5", "", gain=100.0, smooth_covariates=("q5",))
    assert is_law_of_function(function, named) == is_same
    assert _explains_more(function, named, 100.0) != is_same


@pytest.mark.parametrize(
    "effect, others",
    [
        (law("transmission-harmonic", "joint-2", order=2.0), []),
        (law("gravity-bearing-compliance", "joint-2"), [("gravity-compliance", "link-2")]),
        (law("bearing-compliance", "joint-4"), [("link-compliance", "link-4")]),
        (law("link-compliance", "link-1"), [("pedestal-compliance", "base")]),
        (law("link-compliance", "link-2"), []),
        (
            law("backlash", "joint-2", seat="gravity", width=15.0),
            [("joint-compliance", "joint-2")],
        ),
        (law("backlash", "joint-2", seat="gravity", width=0.5), []),
    ],
)
def test_laws_say_which_others_make_the_same_of_any_poses(effect, others):
    assert [(name, where) for name, where, _ in effect.confounded_with] == others


def test_a_size_has_the_variance_between_the_probable_sets():
    """Law of total variance: 0.3 within and 0.4 between them are 0.5 together."""
    rows = ({"std": 0.3, "value": 2.0}, {"std": 0.1, "value": 5.0})
    first, second = with_variation(rows, 0.2)
    assert first == {"std": pytest.approx(0.5), "value": 2.0}
    assert second == rows[1]
    assert with_variation(rows, 0.0) == rows


@pytest.mark.parametrize(
    ("kind", "stated", "where"),
    [
        ("GravityLink", "link-compliance", "link-2"),
        ("GravityLink", "link-compliance", "link-3"),
        ("GravityBearing", "bearing-compliance", "joint-2"),
    ],
)
def test_unknown_first_moments_make_the_moments_of_any_masses(kind, stated, where):
    """Wherever the centres of mass are: off the line between two axes, and the weight at the end of a link, too."""
    state = bench_of(recorded(7, n=60)).chain.state
    true = law(stated, where).basis(state).ravel()
    made = getattr(unknown_masses, kind)(where).basis(state)
    columns = made.reshape(len(made), -1).T
    left = true - columns @ np.linalg.lstsq(columns, true, rcond=1e-10)[0]
    assert np.abs(left).max() < 1e-8 * np.abs(true).max()


def test_a_bent_link_of_an_arm_without_masses_is_no_compliance_of_its_joints():
    """Masses off the line between the axes had been explained by a second law, of a joint that is stiff."""
    recording = without_masses(recorded(7, [law("link-compliance", "link-2")], [8e-6]))
    found = find(bench_of(recording)).findings
    assert [(f.effect, f.where) for f in found] == [("gravity-compliance", "link-2")]
    assert found[0].probability > 0.5
