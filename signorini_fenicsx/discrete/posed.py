"""What a hybrid backend knows of its last solve: the problem, and what the solution is to it."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.contact.chains import SiteConditions
from signorini_fenicsx.contact.sites import SiteKind
from signorini_fenicsx.discrete.vertex_laws import Springs
from signorini_fenicsx.linear.constrained_matrix import Imposed


class State(Enum):
    """What the last solution x is to a `TraceBackend`."""

    START = auto()
    POSED = auto()
    ROUGH = auto()
    SOLVED = auto()


@dataclass(frozen=True)
class Posed:
    """The problem under some conditions.

    Attributes:
        conditions: The conditions.
        springs: Those of laws at the facet vertices, with their kinds of sites; empty if there are none.
        imposed: What the linear solver imposes at the sites.
        weak: The stiffness of the weak springs that pull at each site of a body.
        loose: Whether a motion of a body is free but for weak springs.
    """

    conditions: SiteConditions
    springs: Sequence[tuple[SiteKind, Springs]]
    imposed: Imposed
    weak: Array | float = 0.0
    loose: bool = False
