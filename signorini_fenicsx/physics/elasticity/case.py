"""Case files of elastic contact, `physics = "elasticity"`."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from signorini_fenicsx.cases.case import Cost, Solve
from signorini_fenicsx.cases.complaints import told
from signorini_fenicsx.cases.data_section import DataSection, KindSection, data_section
from signorini_fenicsx.cases.first_case import GIVEN, HELD, SYMMETRIC
from signorini_fenicsx.cases.pairs import BETWEEN, OF_KIND, OF_LAWS, PairTexts, WithPairs
from signorini_fenicsx.cases.parts import PartLists
from signorini_fenicsx.cases.plot import OF_BODIES
from signorini_fenicsx.cases.values import (
    Directions,
    Expression,
    ExpressionByPart,
    Moduli,
    Stiffnesses,
    Vector,
    VectorByPart,
    choice,
)
from signorini_fenicsx.contact.laws import LAWS, Friction
from signorini_fenicsx.discrete.on_parts import one_value
from signorini_fenicsx.discrete.pairs import Pair
from signorini_fenicsx.expressions.given import Given
from signorini_fenicsx.meshes.paired_parts import without_law
from signorini_fenicsx.physics.elasticity.conditions import Contact, Coulomb, JointSprings, Tresca, on_slave
from signorini_fenicsx.physics.elasticity.problem import (
    ElasticBoundary,
    ElasticProblem,
    GivenAxes,
    GivenByPart,
    GivenModulus,
    GivenSupports,
    GivenVector,
    GivenVectorByPart,
    Meeting,
    PlaneState,
    of_meeting,
)
from signorini_fenicsx.physics.elasticity.scope import outside
from signorini_fenicsx.physics.elasticity.solving import rule_of
from signorini_fenicsx.solving.options import Options

COSTS = {2: Cost(4, 1e4, 6e3, 3e3), 3: Cost(9, 4.5e4, 1500, 300)}
"""On 110 000 to 1 300 000 unknowns; an order of magnitude."""


class ElasticParts(PartLists):
    """`[boundary]`: the parts in contact, with given traction, and fixed in some components; the rest is Γ_D.

    Where two bodies touch, the part is one of "inner" as well.
    """

    contact: list[str] = Field(default=[])
    neumann: list[str] = Field(default=[])
    fixed: dict[str, str] = Field(default={})
    dirichlet: list[str] | None = None

    @model_validator(mode="after")
    def _components(self) -> Self:
        with told():
            self.read(self.contact)
        return self

    def read(self, contact: list[str], turned: Sequence[str] = (), pairs: Sequence[Pair] = ()) -> ElasticBoundary:
        """The boundary for the solver, with these parts in contact, some of which have their law from the other side.

        The other parts of pairs have no condition.

        Raises:
            InputError: If a component is unknown.
        """
        paired = [each.on_boundary for each in pairs]
        pulled = [*self.neumann, *without_law(paired)]
        return ElasticBoundary(contact, pulled, self.fixed, self.inner, turned=turned, pairs=paired)


OF_DATA = OF_LAWS | {
    GivenVector: Vector,
    GivenVectorByPart: VectorByPart,
    GivenByPart: ExpressionByPart,
    GivenModulus: Moduli,
    GivenSupports: Stiffnesses,
    GivenAxes: Directions,
    Mapping[str, Given]: dict[str, Expression],
}


WITHOUT_FRICTION = data_section(
    Contact,
    OF_DATA,
    ("surface", "behind"),
    surface=str | None,
    behind=bool,
    gap=None,
    parts=None,
    side=None,
    friction=None,
)


class FrictionTexts(DataSection):
    """The data of friction."""

    g: Expression | None = None
    mu: Expression | None = None

    @model_validator(mode="after")
    def _one_bound(self) -> Self:
        if self.g is None and self.mu is None:
            raise ValueError("the law 'friction' must have g, a bound of the shear, or mu, its coefficient, or both")
        return self


class WithFriction(FrictionTexts, WITHOUT_FRICTION):  # type: ignore[misc, valid-type]
    """The data of contact with friction."""


WITHOUT_SURFACE: dict[str, type[DataSection]] = {"contact": DataSection, "friction": FrictionTexts, "tied": DataSection}
WITH_CONTACT: dict[str, type[DataSection]] = {"contact": WITHOUT_FRICTION, "friction": WithFriction}
OF_JOINT = data_section(JointSprings, OF_DATA, parts=None, side=None, friction=None, gap=None)


class JointTexts(FrictionTexts, OF_JOINT):  # type: ignore[misc, valid-type]
    """The data of a joint with springs."""


JOINT = "joint_springs"
NORMAL = tuple(name for name in BETWEEN if LAWS[name] is not Friction)


IN_WORDS = {
    "contact": ("Contact without friction.", []),
    "friction": ("Contact with Coulomb's friction, |σ_t| ≤ mu · pressure.", ["mu = 0.3"]),
    JOINT: (
        "Springs across and along a joint, which slips, |σ_t| ≤ mu · pressure.",
        ["normal = 10", "shear = 5", "mu = 0.3"],
    ),
}


class ContactTexts(KindSection):
    """`[[law]]`: contact on parts of Γ_C, with friction by g, the bound of the shear, by μ, Coulomb's number, or both.

    The foundation may be a `surface` in a mesh file. With `force` and `moment` it is a rigid tool that moves along and
    about these axes. Other kinds are laws between the opening gap − u_n and the pressure, with their keys in scalar
    problems.
    """

    word = "law"
    of_kind = WITH_CONTACT | {name: OF_KIND[name] for name in NORMAL} | {JOINT: JointTexts}
    kind: Annotated[str, choice("law of elastic contact", tuple(of_kind))]
    parts: list[str] = Field(min_length=1)
    gap: Annotated[Expression | None, Field(default=None, exclude_if=lambda gap: gap is None)]

    def made(self) -> Meeting:
        """The law, without its gap."""
        data = dict(self.model_extra or {})
        if self.kind in LAWS and self.kind not in WITH_CONTACT:
            return LAWS[self.kind](self.parts, **data)
        return (
            _joint(self.parts, data)
            if self.kind == JOINT
            else Contact(self.parts, friction=_friction_or_none(data), **data)
        )

    def texts(self) -> list[tuple[str, str]]:
        """Each expression with the name of its key."""
        return [*([] if self.gap is None else [("gap", self.gap)]), *super().texts()]


def _friction_or_none(data: dict[str, Any]) -> Tresca | Coulomb | None:
    """The friction of some data, whose bound is taken out of them."""
    bounds = {key: data.pop(key) for key in ("g", "mu") if key in data}
    return (Coulomb if "mu" in bounds else Tresca)(**bounds) if bounds else None


def _joint(parts: Sequence[str], data: dict[str, Any]) -> JointSprings:
    """The springs of a joint on some parts."""
    friction = _friction_or_none(data)
    assert friction is not None
    return JointSprings(parts, **data, friction=friction)


class ElasticPair(PairTexts):
    """`[[pair]]` of bodies: contact, friction, or another law between opening and pressure."""

    of_kind = WITHOUT_SURFACE | {name: OF_KIND[name] for name in NORMAL} | {JOINT: JointTexts}
    kind: Annotated[str, choice("kind of a pair", tuple(of_kind))]
    gap: Expression = "distance"

    def law(self) -> Any:
        """The law, without parts; None for contact without friction."""
        data = dict(self.model_extra or {})
        if self.kind == JOINT:
            return _joint((), data)
        return _friction_or_none(data) if self.kind in WITH_CONTACT else super().law()

    def made(self) -> Pair:
        """The pair."""
        return replace(super().made(), gap=self.gap)

    def texts(self) -> list[tuple[str, str]]:
        """Each expression with the name of its key; of the gap what is given besides the distance."""
        return [("gap", str(self.made().added[1])), *super().texts()]


OF_PROBLEM = data_section(
    ElasticProblem,
    OF_DATA,
    ("plane",),
    gap=Expression,  # single parts have theirs in a [[law]]
    surface=None,
    force=None,
    moment=None,
    plane=Annotated[str, choice("plane", tuple(PlaneState))],
    exact=None,
    laws=None,
    numbers=None,
    joint=None,
    boundary=None,
    viscosity=None,
)


class ElasticTexts(OF_PROBLEM):  # type: ignore[misc, valid-type]
    """`[problem]`: the data of an `ElasticProblem` as text in x, y, z; the material may have one for each region."""


class ElasticExact(DataSection):
    """`[exact]`: the displacement, where it is known, as text in x, y, z."""

    u: Vector | None = None


def check_solve(solve: Solve, what: str) -> None:
    """Refuse what bodies and flows do not have in `[solve]`.

    Raises:
        ValueError: If the algorithm is none of theirs, or a key is not.
    """
    with told("[solve] "):
        rule_of(Options(algorithm=solve.algorithm))
    for key in ("backend", "element", "rho", "eps"):
        if key in solve.model_fields_set:
            raise ValueError(f"[solve] {key}: {what} has no such key")


FIRST_DATA = (
    ("young = 1", "Young's modulus; also by region or body: {{up = 1, low = 2}}", ""),
    ("poisson = 0.3", "Poisson's ratio", ""),
    ("f = {down}", "the load", ""),
    ("u_D = {zero}", "the displacement on the rest", HELD),
    ("g_N = {zero}", "the traction σn on the parts in neumann; also by part: {{top = […]}}", GIVEN),
    ("gap = 0", "to what the body touches, along the outer normal", " ".join(WITH_CONTACT)),
)
"""See `CaseFile.first_data`."""


class ElasticCase(WithPairs):
    """One problem of elastic contact, its discretisation and its algorithm."""

    PHYSICS: ClassVar[str] = "elasticity"
    physics: Literal["elasticity"]
    boundary: ElasticParts
    problem: ElasticTexts
    law: Annotated[list[ContactTexts], Field(default=[], exclude_if=lambda laws: not laws)]
    pair: Annotated[list[ElasticPair], Field(default=[], exclude_if=lambda pairs: not pairs)]
    exact: ElasticExact = ElasticExact()
    plot_keys = OF_BODIES
    costs: ClassVar[Mapping[int, Cost]] = COSTS

    @property
    def columns_of_step(self) -> dict[str, tuple[str, int, str]]:
        """What is printed of a step besides that of all physics, see `CaseFile.columns_of_step`."""
        return {"contact_force": ("force", 11, ".5g")} | super().columns_of_step

    first_words = (*WITH_CONTACT, SYMMETRIC, JOINT, *NORMAL)
    first_listed = tuple(WITH_CONTACT)
    first_data = FIRST_DATA
    first_laws = IN_WORDS
    first_pairs = tuple(sorted(ElasticPair.of_kind, key=lambda kind: kind != "contact"))
    inner_needs = "contact: list it there as well, or in a [[law]]"
    held = "clamped, u = u_D"
    is_vector = True

    @property
    def states(self) -> tuple[str, str]:
        """What reports call vertices under the two conditions; with friction in the tangential component as well."""
        return (
            ("free", "held") if {each.kind for each in [*self.law, *self.pair]} - {"contact"} else ("open", "contact")
        )

    @property
    def lists(self) -> dict[str, list[str]]:
        """The parts of laws, and those in contact without one, see `CaseFile.lists`."""
        in_laws, fixed = super().meeting, self.boundary.fixed
        alone = {key: [part for part in parts if part not in fixed] for key, parts in super().lists.items()}
        friction = [f"law.{i}.parts" for i, law in enumerate(self.law) if law.kind == "friction"]
        for key in friction:  # beside a law in the normal direction
            in_normal = [other for other in alone if other not in (*friction, *self.in_pairs)]
            others = [part for other in in_normal for part in alone[other]]
            alone |= {key: [part for part in alone.get(key, []) if part not in others]}
        return alone | self.in_pairs | {"contact": [part for part in self.boundary.contact if part not in in_laws]}

    @property
    def meeting(self) -> list[str]:
        """The parts in contact, listed or with a `[[law]]`."""
        return [*dict.fromkeys([*self.boundary.contact, *super().meeting])]

    def condition_of(self, part: str) -> str:
        """The condition on a part, in a word."""
        word = "elastic support" if part in self.problem.support else super().condition_of(part)
        return {"friction": "contact with friction"}.get(word, word)

    @property
    def approach(self) -> str:
        """What is solved and how, in words."""
        return f"{'elastic contact' if self.meeting or self.pair else 'elasticity'}, {self.solve.algorithm}"

    @property
    def unproved(self) -> str:
        """Why `--rigorous` is not for the case; see `CaseFile.unproved`."""
        return outside(self.posed(3))

    @model_validator(mode="after")
    def _solvable(self) -> Self:
        check_solve(self.solve, "elastic contact")
        return self

    def posed(self, dim: int) -> ElasticProblem:
        """The parts and the data, see `CaseFile.posed`."""
        values: dict[str, Any] = dict(self.problem)
        gaps = dict.fromkeys(self.boundary.contact, self.problem.gap)
        gaps |= {part: self.problem.gap if law.gap is None else law.gap for law in self.law for part in law.parts}
        pairs = [pair.made() for pair in self.pair]
        on_slaves = [law for pair in pairs if (law := on_slave(pair)) is not None]
        gaps |= {part: pair.added[1] for pair in pairs if not pair.on_boundary.tied for part in pair.slave}
        values["gap"] = one_value(gaps, self.problem.gap)
        laws = [law.made() for law in self.law]
        turned = [part for law in laws if getattr(law, "behind", False) for part in law.parts]
        contact = [*self.meeting, *(part for each in on_slaves for part in each.parts)]
        meeting, boundary = of_meeting([*laws, *on_slaves]), self.boundary.read(contact, turned, pairs)
        return ElasticProblem(**values, **meeting, exact=self.exact.u, boundary=boundary)
