"""What programs need that bring their own algorithm, discretisation or law.

Your own algorithm is a start and a rule; here Algorithm 1 as an example:

>>> import numpy as np
>>> from mpi4py import MPI
>>> from signorini_fenicsx import Diffusion, Options, Signorini, solve
>>> from signorini_fenicsx.meshes.meshing import build_domain
>>> square = build_domain(MPI.COMM_WORLD, "square", 0.1, mesh="structured")
>>> problem = Diffusion(f="40*(x - 0.6)", conditions=[Signorini("bottom")])
>>> def rule(p, flux, rho):
...     return np.where(flux > rho * p, Condition.ZERO_TRACE, Condition.NO_FLUX).astype(np.int8)
>>> mine = SetRule(start=Condition.NO_FLUX, rule=rule)
>>> one, other = (solve(square, problem, Options(algorithm=algorithm)) for algorithm in (mine, "alg1"))
>>> one.contact == other.contact
True

Your own law is a `Law`, a class whose method `graph` gives a `Graph`; that of a `LawWithMemory` depends on what has
happened. The docstring of `contact.law` has an example of each. Your own discretisation is a `Backend`: an object that
solves one linear problem under given conditions on its sites. With `FacetBackend` it needs `name`, `dofs`, `solver` and
`solve`. Your own method is a `Method`, whose `run` gets a `Task` and returns an `Outcome`. All of them are options:
`Options(algorithm=…, backend=…)`.

`Instant` is what `evolve` yields, and `write_solution` writes a solution with what else is known of it; a program that
only solves needs neither name. `LaterFailure` is the `NumericalFailure` of a run whose solution is kept.
"""

from signorini_fenicsx.base.errors import LaterFailure
from signorini_fenicsx.contact.backend import Backend, Iterate
from signorini_fenicsx.contact.chains import Condition, Penalty, SiteConditions
from signorini_fenicsx.contact.history import Outcome, Step
from signorini_fenicsx.contact.law import Graph, Law, LawWithMemory
from signorini_fenicsx.contact.set_rules import SetRule
from signorini_fenicsx.methods.registry import METHODS, Method
from signorini_fenicsx.methods.task import Task
from signorini_fenicsx.output.writing import write_solution
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solve.facets import FacetBackend
from signorini_fenicsx.solving.evolving import Instant

__all__ = [
    "METHODS",
    "Backend",
    "Condition",
    "Data",
    "FacetBackend",
    "Graph",
    "Instant",
    "Iterate",
    "LaterFailure",
    "Law",
    "LawWithMemory",
    "Method",
    "Outcome",
    "Penalty",
    "SetRule",
    "SiteConditions",
    "Spaces",
    "Step",
    "Task",
    "write_solution",
]
