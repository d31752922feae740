"""What an elastic backend knows of its last solve: the problem, and what the solution is to it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.contact.conditions import SiteConditions
from signorini_fenicsx.linear.kept_factors import Imposed
from signorini_fenicsx.physics.elasticity.discrete.normal_laws import Springs


class State(Enum):
    """What the last solution x is to an `ElasticBackend`."""

    START = auto()
    POSED = auto()
    ROUGH = auto()
    SOLVED = auto()


@dataclass(frozen=True)
class Posed:
    """The problem under some conditions.

    Attributes:
        conditions: The conditions.
        springs: Those of laws at the facet vertices; None if there are none.
        weak: The stiffness of the weak springs that pull at each site.
        loose: Whether a motion of the body is free but for weak springs.
        imposed: What the linear solver imposes at the sites.
    """

    conditions: SiteConditions
    springs: Springs | None
    weak: Array
    loose: bool
    imposed: Imposed
