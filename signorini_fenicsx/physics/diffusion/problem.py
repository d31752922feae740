"""The data of a problem as the user gives them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.laws import Law
from signorini_fenicsx.expressions.given import Given, at_time, parsed


@dataclass(frozen=True)
class Problem:
    """−∇·(κ∇u) + cu = f, u = u_D on Γ_D, κ∇u·n = g_N on Γ_N; on Γ_S u ≥ ψ and κ∇u·n ≥ q_S, with equality in one.

    On the parts of `laws` these hold instead of ψ and q_S. With an obstacle u ≥ obstacle and −∇·(κ∇u) + cu ≥ f in Ω,
    with equality in one of them.

    Attributes:
        f: Load, or one for each region of the mesh.
        kappa: κ: a scalar, a symmetric positive definite matrix, or one of these for each region of the mesh.
        u_D: Trace on Γ_D, continuous.
        g_N: Flux κ∇u·n on Γ_N, with the outer normal n.
        psi: Lower bound of the trace on Γ_S, continuous.
        q_S: Lower bound of the flux on Γ_S.
        c: c ≥ 0, or one for each region of the mesh. Where it is positive somewhere, no Γ_D is needed.
        obstacle: Lower bound of u in Ω, continuous, at most u_D on Γ_D; None for none.
        exact: The exact u, where it is known, or one for each region.
        laws: Other laws on Γ_S. Their parts belong to Γ_S and need not be listed in `Boundary`.

    Raises:
        InputError: If `laws` is not a list of laws.
    """

    f: Given | Mapping[str, Given]
    kappa: Given | Mapping[str, Given] = 1.0
    u_D: Given = 0.0
    g_N: Given = 0.0
    psi: Given = 0.0
    q_S: Given = 0.0
    c: Given | Mapping[str, Given] = 0.0
    obstacle: Given | None = None
    exact: Given | Mapping[str, Given] | None = None
    laws: Sequence[Law] = ()

    def __post_init__(self) -> None:
        """Refuse a law that is not in a list."""
        if not isinstance(self.laws, Sequence) or not all(isinstance(law, Law) for law in self.laws):
            raise InputError('laws: must be a list of laws, such as [Friction(["left"], g=1)]')

    def at(self, t: float) -> "Problem":
        """The problem at a time, from one that `in_time` has read."""
        data = {field.name: at_time(getattr(self, field.name), t) for field in fields(self) if field.name != "laws"}
        return replace(self, **data, laws=tuple(law.with_data(lambda _, given: at_time(given, t)) for law in self.laws))

    def in_time(self, dim: int) -> "Problem":
        """The same problem, with numbers and texts read as trees that may have t in them, also those of the laws.

        Raises:
            InputError: If a text cannot be read.
        """
        names = "xyz"[:dim] + "t"
        data = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "laws"}
        laws = tuple(law.with_data(lambda key, given: parsed(given, names, key)) for law in self.laws)
        read = {name: parsed(given, names, _place(name)) for name, given in data.items()}
        return replace(self, **read, laws=laws)

    def parsed(self, dim: int) -> "Problem":
        """The same problem, with numbers and texts read as trees, but not those of the laws.

        Raises:
            InputError: If a text cannot be read.
        """
        names = "xyz"[:dim]
        data = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "laws"}
        return replace(self, **{name: parsed(given, names, _place(name)) for name, given in data.items()})


def _place(name: str) -> str:
    """Where a case file has a datum."""
    return "[exact] u" if name == "exact" else f"[problem] {name}"
