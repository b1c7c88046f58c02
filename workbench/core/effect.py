"""Definition of a physical effect: a perturbation of one port of a measuring chain."""

import inspect
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Protocol

import numpy as np
from pydantic import TypeAdapter, ValidationError

from workbench.core.errors import InputError
from workbench.core.parameters import Parameter
from workbench.core.vocabulary import Place


class Recorded(Protocol):
    """A machine with a recording, as input to the choice of candidates; only its covariates are used."""

    def places(self, kind: str) -> tuple[str, ...]: ...  # what `where` may be: "joint-1", ...
    def varies(self, covariate: str) -> bool: ...  # whether it is known and not constant
    def slides(self, joint: int) -> bool: ...  # whether joint K is prismatic


@dataclass(frozen=True)
class Variant:
    """A candidate explanation of a diagnosis: an effect with given options at one place.

    `label`: what distinguishes it from other variants at that place ("order 2"). `prior_weight`: its share
    of the prior probability of its family, relative to the other members. `missing_covariate`: the kind of
    covariate that the law needs and the recording does not hold ("temperature"), for which another
    one (time) is used instead; "" where nothing is missing. `option`: name of the option that is a real number, of
    which the variants of a family hold a few values; `word`: format string of their labels. "" of all others.
    """

    effect: "Effect"
    label: str = ""
    prior_weight: float = 1.0
    missing_covariate: str = ""
    option: str = ""
    word: str = ""

    @property
    def family(self) -> str:
        """Variants at one place that share one prior probability: those of one effect, or of several that say so."""
        return f"{self.effect.family or self.effect.effect} {self.effect.where}"


@dataclass(frozen=True)
class Grid:
    """Variants of an effect at one place that differ in one `option`, over a fine grid of its values.

    `shape` "step": 0 up to `value` of the `covariate` and 1 beyond it; "wave": cosine and sine of `value` times the
    covariate; "period": those of 2 pi times the covariate over `value`. Each of the k components of the effect has
    its own amplitude. `values` (V,) ascending; `prior_weights` (V,) prior weight of each, relative to the others;
    `typical`: prior size of the amplitudes, one or (k,), in the units of the components; `label`: format string of
    a variant's label ("order {:g}"); `factor` (k, n): what the amplitude of a component is multiplied by at each
    sample, where it is not 1 (a lever arm), or (r, k, n): r amplitudes with shares in all components;
    `port_indices` (k): the component of each amplitude, where several act on one component with factors of their
    own. `centred`: the evidence is that of a step less its mean. Another law has the factor all the time
    (deflection under gravity), and a step near the start must not stand in for it.
    """

    effect: type["Effect"]
    where: str
    option: str
    shape: str
    covariate: str
    values: np.ndarray
    prior_weights: np.ndarray
    typical: float | tuple[float, ...]
    label: str
    factor: np.ndarray | None = None
    port_indices: tuple[int, ...] = ()
    centred: bool = False

    def make(self, value: float) -> "Effect":
        """The effect for one value, which gets the type of the grid's values."""
        return self.effect(self.where, **{self.option: self.values.dtype.type(value).item()})


class Effect:
    """A cause of error at one place (`where`) that acts through one `port` of a chain.

    An effect says which `port_indices` of its port it perturbs (m of them), which parameters it has (P)
    and, for n samples, by how much. Nearly every effect is linear in its parameters and gives
    `basis`; one that is not overrides `delta`, and its derivative is then taken numerically from
    `delta` alone. `delta` is exactly 0 at the null of all its parameters. The chain
    numbers the components of its ports.

    The attributes below `source` describe the effect to the diagnosis and to the blind benchmark, which hold no list of
    effects of their own.

    Attributes:
        effect: Name, a word of the vocabulary.
        port: What it perturbs, a word of the vocabulary: "joint", "geometry", "pixel", ...
        places: What `where` may be: "joint", "link", "base", ...
        needs: Covariates that must be recorded.
        surface: Required knowledge of the surface: "normals", "ball".
        components: Which components of its port at its place; () for all of them.
        estimates_moments: Whether first mass moments of the links are among its parameters.
        turning: Whether it speaks of a rotation of its joint, which a prismatic joint does not make.
        by_moves: Whether it reads the last moves of the joints, which the order of the samples tells.
        elastic: Whether it reads torques or moments, so that gravity and masses act through it.
        equation: Its law.
        source: Publication of the law.
        nonnegative: How many of its first parameters cannot be negative (a compliance).
        largest: Largest plausible value of its only parameter, in the unit of that; inf where nothing limits it.
        family: Name of the family of variants that it belongs to; its own name where empty.
        coexists: Whether several variants may act at one place (orders of a harmonic).
        subsumes: Names of effects that are special cases of this one.
        confounded_with: Laws that make nearly the same of any poses and are as likely before measuring: effect, place
            and label of each. No recording distinguishes them, so that they are named and not searched.
        distinguished_by: What to do to distinguish it from these laws, as an instruction; "" where nothing is known.
        mass_dependent: Whether its signature depends on masses, which may be uncertain.
        compliance_prior: Of a compliance, the prior probability that it is of a size worth modelling, and its typical
            size relative to the compliance of a joint; None where it has none in rad/(N m).
        needs_compliance: Whether it is observable only where the model contains a compliance.
        of_session: Whether it belongs to the measuring session and not to the machine, so that a correction of the
            machine leaves it out.
        beyond_flange: Whether it displaces what the flange carries and not the flange, so that a correction of the
            flange leaves it out.
        reads: Names or kinds of the covariates that its law is a function of, recorded or derived.
        unrecorded: The kind of covariate without which it may look like random scatter at its place.
        stage: The stage of the default plan that fits it, where `planned` says.
        plant_weight: How often the blind benchmark plants it into real recordings, as `planted` says.

    Examples:
        >>> from robot_model.effects.elastic import JointCompliance
        >>> effect = JointCompliance("joint-2")
        >>> isinstance(effect, wb.Effect), effect.port, effect.number
        (True, 'joint', 2)
    """

    effect = ""
    port = ""
    places: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    surface: tuple[str, ...] = ()
    components: tuple[
        int, ...
    ] = ()  # which components of its port at its place; () for all of them
    turning = False  # True: speaks of a turn of its joint, which a slide does not make
    by_moves = False  # True: reads the joints' last moves, which the order of the samples tells
    elastic = (
        False  # True: reads the state's torques or moments, so gravity and masses act through it
    )
    estimates_moments = False
    equation = ""
    source = ""
    nonnegative = 0
    largest = np.inf
    family = ""
    coexists = False
    subsumes: tuple[str, ...] = ()
    confounded_with: tuple[tuple[str, str, str], ...] = ()
    distinguished_by: str = ""
    mass_dependent = False
    compliance_prior: tuple[float, float | None] | None = None
    needs_compliance = False
    of_session = False
    beyond_flange = False
    reads: tuple[str, ...] = ()
    unrecorded = ""
    stage = ""
    plant_weight = 0.0

    def __init_subclass__(cls, **options):
        """Raises TypeError for a class that overrides `slots`, which nothing calls: its components would be ignored."""
        super().__init_subclass__(**options)
        if "slots" in vars(cls):
            raise TypeError(
                f"effect {cls.__name__}: expected port_indices(chain), found its earlier name slots; rename the method"
            )

    def __init__(self, where: str):
        self.where = where

    @classmethod
    def candidates(cls, chain: Recorded) -> Iterable[Variant]:
        """Variants worth testing on a recording, judged by its covariates and never by a residual.

        By default one variant at every place of this machine, if all covariates of `needs` vary.
        """
        for place in cls.places:
            for where in chain.places(place):
                effect = cls(where)
                if cls.turning and chain.slides(effect.number):
                    continue
                if all(chain.varies(name) for name in effect.needs):
                    yield Variant(effect)

    @classmethod
    def grids(cls, chain: Recorded) -> Iterable[Grid]:
        """Families of variants over a fine grid of one option; none by default."""
        return ()

    @classmethod
    def planned(cls, chain: Recorded) -> Iterable[tuple[str, dict]]:
        """(where, options) of the terms that the default plan fits on a recording; none by default."""
        return ()

    @classmethod
    def planted(cls, readings, joint: int, rng: np.random.Generator) -> tuple[dict, np.ndarray]:
        """A random instance for the blind benchmark: its details, and the change (n,) of a joint's angle per unit size.

        readings: `angles` (J, n) rad, `poses` (n,) and `columns` of the recording. joint: its number, from 1.
        An effect with a `plant_weight` implements it, independently of `basis`.
        """
        raise NotImplementedError

    def option_unit(self, chain: Recorded, name: str) -> str:
        """Unit of an option that is a real number, which a diagnosis estimates; "1" by default (an order)."""
        return "1"

    @property
    def place(self) -> Place:
        """`where` as a place."""
        return Place.of(self.where)

    @property
    def number(self) -> int:
        """K of `joint-K`, `link-K`, `ball-K`."""
        return self.place.number

    def parameters(self, chain) -> tuple[Parameter, ...]:
        """The P parameters, keys `<where>.<effect>.<name>`. Raises InputError if the chain has no such place."""
        self.check(chain)
        return self.table(chain)

    def table(self, chain) -> tuple[Parameter, ...]:
        """The parameters for an existing place; called by `parameters`."""
        raise NotImplementedError

    def check(self, chain) -> None:
        """Raise InputError if the chain has no such joint, link or ball, or if a joint is not revolute as required."""
        place = self.place.kind
        if place in NUMBERED:
            self._check_number(place, chain.numbers(place))
        if self.turning and chain.slides(self.number):
            raise InputError(
                f"{self.title}: expected a revolute joint, found a prismatic one; remove the effect or change its place"
            )

    def _check_number(self, place: str, known) -> None:
        if self.number not in known:
            raise InputError(
                f"{self.title}: expected {place}-K with K one of {', '.join(map(str, known))}, "
                f"found '{self.where}'; correct the place"
            )

    def port_indices(self, chain) -> tuple[int, ...]:
        """The components of its port that this effect perturbs, m row numbers."""
        return chain.port_indices(self.port, self.where, self.components)

    def basis(self, state) -> np.ndarray:
        """(P, m, n) change of each component per unit of each parameter."""
        raise NotImplementedError

    def delta(self, p: np.ndarray, state) -> np.ndarray:
        """(m, n) change of the components, in the port's unit, for parameters p (P,)."""
        return np.tensordot(p, self.basis(state), 1)

    def derivative(self, p: np.ndarray, state) -> np.ndarray:
        """(P, m, n) d delta / d p."""
        if self.linear:
            return self.basis(state)
        return numeric_derivative(lambda x: self.delta(x, state), p, self.steps())

    def extrapolation(
        self, p: np.ndarray, state, recorded: Mapping[str, tuple[float, float]] | None = None
    ) -> np.ndarray | None:
        """(m, n) 1 sigma of what an empirical function leaves open beyond its recorded range, in its components.

        It is the size of the function's changes over such a distance within the range; 0 within it. A law of time is
        as uncertain after the recording as its change since then. None for other laws.
        recorded: covariate, `q2` for joint 2 or `time`, -> lowest and highest value (rad, mm, s), as far as known.
        """
        return None

    def shrinkage_groups(self) -> tuple[str, ...]:
        """Names of the groups in which its parameters share a prior scale, one a parameter; () for one group."""
        return ()

    @property
    def linear(self) -> bool:
        """True for an effect that gives a basis: linear in its parameters."""
        return type(self).delta is Effect.delta

    def steps(self) -> float | np.ndarray:
        """Half-steps of the numeric derivative, in the units of the parameters."""
        return 1e-6

    def parameter(
        self, name: str, unit: str, typical: float, label: str, prior: float | None = None
    ) -> Parameter:
        """A parameter of this effect, null 0, its key made from place, effect and `name`.

        prior: 1 sigma of what is known before measuring; three typical sizes where not given.
        """
        return Parameter(
            f"{self.where}.{self.effect}.{name}", unit, 0.0, typical, label, prior or 3 * typical
        )

    @property
    def options(self) -> dict:
        """Constructor arguments other than the place, by name, for files; without those that are left out (None)."""
        options = {name: getattr(self, name) for name in _option_names(type(self))}
        return {name: value for name, value in options.items() if value is not None}

    @property
    def carries_load(self) -> bool:
        """Whether it deflects under gravity, so that what changes gravity or masses acts through it."""
        return self.elastic and not self.needs_compliance

    @property
    def title(self) -> str:
        return f"{self.effect} at {self.where}"


@cache
def _option_names(kind: type[Effect]) -> tuple[str, ...]:
    """Names of the constructor's arguments other than the place."""
    return tuple(inspect.signature(kind).parameters)[1:]


def numeric_derivative(function, p: np.ndarray, step) -> np.ndarray:
    """(P, ...) central differences of `function` at p (P,) with half-steps `step`."""
    steps = np.diag(np.broadcast_to(np.asarray(step, float), np.shape(p)))
    return np.stack([(function(p + h) - function(p - h)) / (2 * h.sum()) for h in steps])


def make_effects(
    catalogue: Mapping[str, type[Effect]], rows: Iterable[tuple[str, str, dict]]
) -> tuple[Effect, ...]:
    """Effects from (effect, where, options) rows, looked up in a package's catalogue.

    Raises InputError for a name that is not in the catalogue, a place where that effect cannot
    sit, or an option that it does not have.
    """
    return tuple(_make(catalogue, *row) for row in rows)


def option_types(kind: type[Effect]) -> dict[str, object]:
    """Name -> type of each option of an effect's constructor, without bounds (float of Annotated[float, ...])."""
    signature = inspect.signature(kind)
    options = list(signature.parameters.values())[1:]
    return {
        option.name: getattr(option.annotation, "__origin__", option.annotation)
        for option in options
    }


NUMBERED = ("joint", "link", "ball", "reflector")


def _sits(kind, where) -> bool:
    """Whether `where` is one of the effect's places, with a number from 1 where places are numbered."""
    if not isinstance(where, str):
        return False
    place = Place.of(where)
    if place.kind not in kind.places or str(place) != where:
        return False
    if place.kind in NUMBERED:
        return (place.number or 0) > 0
    return place.number is None


def _make(catalogue, name, where, options) -> Effect:
    if not isinstance(name, str) or name not in catalogue:
        raise InputError(
            f"no effect is called '{name}': known are {', '.join(sorted(catalogue))}; choose one of them"
        )
    kind = catalogue[name]
    if not _sits(kind, where):
        places = ", ".join(f"{place}-K" if place in NUMBERED else place for place in kind.places)
        raise InputError(
            f"effect '{name}' cannot sit at '{where}': expected {places}; correct the place"
        )
    return kind(where, **_checked(kind, name, options))


def _checked(kind, name, options) -> dict:
    """The options, converted to the types of the effect's constructor; none may be missing or unknown."""
    known = dict(list(inspect.signature(kind).parameters.items())[1:])
    missing = [
        key
        for key, option in known.items()
        if option.default is option.empty and key not in options
    ]
    if missing:
        raise InputError(f"effect '{name}': option {missing[0]} is expected, found none; add it")
    for key, value in options.items():
        if key not in known:
            expected = ", ".join(known) or "no option"
            raise InputError(
                f"effect '{name}' does not take these options: expected {expected}, found {key}; remove it"
            )
        try:
            TypeAdapter(known[key].annotation, config={"allow_inf_nan": False}).validate_python(
                value, strict=True
            )
        except ValidationError as problem:
            message = problem.errors()[0]["msg"].removeprefix("Input should be ")
            raise InputError(
                f"effect '{name}', option {key}: expected {message}, found {value!r}; correct it"
            ) from None
    return options
