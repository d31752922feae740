"""Signorini problems from Python: your own mesh and UFL, your own set rules and discretisations.

>>> import dolfinx.mesh, numpy as np, ufl
>>> from mpi4py import MPI
>>> mesh = dolfinx.mesh.create_unit_square(MPI.COMM_WORLD, 8, 8, ghost_mode=dolfinx.mesh.GhostMode.none)
>>> x = ufl.SpatialCoordinate(mesh)
>>> walls = {"bottom": lambda x: np.isclose(x[1], 0), "right": lambda x: np.isclose(x[0], 1)}
>>> parts = {name: dolfinx.mesh.locate_entities_boundary(mesh, 1, where) for name, where in walls.items()}
>>> domain = domain_of(mesh, parts)
>>> boundary = Boundary(signorini=["bottom"], neumann=["right"])
>>> problem = Problem(f=40 * (x[0] - 0.6), kappa="1 + y^2", psi=lambda x: 0.1 * x[0] - 0.05)
>>> solution = solve(domain, boundary, problem)
>>> solution.converged, solution.contact()[0]
(True, 4)

The rest of the boundary is Γ_D. With mesh tags, `parts = {"wall": tags.find(3)}`. The data are numbers, texts as in a
case file, UFL on the mesh, functions of a finite element space or of points, see `Problem`; κ may be a table by region.

>>> certify(solution).relative < 0.3
True

A problem in time gives one solution after another:

>>> falling = Problem(f="-20*t", psi=-0.05)
>>> [instant.solution.contact()[0] for instant in evolve(domain, boundary, falling, Evolution(end=0.4, steps=2))]
[8, 8]

Other laws on the boundary are objects; their parts need not be listed in `Boundary`:

>>> sliding = Problem(f=40 * (x[0] - 0.6), laws=[Friction(["right"], g="0.2*y"), Wall(["bottom"], beta=2)])
>>> {part: list(segments) for part, segments in solve(domain, Boundary([]), sliding).segments_of_parts().items()}
{'right': ['slip+', 'stick', 'slip-'], 'bottom': ['inflow', 'closed']}

Your own law is a small class, see `signorini_fenicsx.contact.laws`.

A solution gives values at points and fluxes, writes the files of the command line and draws itself in a notebook. See
the docstring of `Solution`:

>>> solution.at([[0.5, 0.25]]).sigma.shape, round(solution.flux_through("bottom"), 3)
((1, 2), 0.706)

`adapt` refines where this bound finds the error. It needs a function that solves the problem on a given mesh of the
domain; UFL data must be written on that mesh:

>>> def solve_on(domain, start):
...     x = ufl.SpatialCoordinate(domain.mesh)
...     return solve(domain, boundary, Problem(f=40 * (x[0] - 0.6), psi=0.1 * x[0] - 0.05), start=start)
>>> finer, certificate = adapt(domain, solve_on, max_cells=500)

`load_solution` reads a solution that was written, `compare` compares two solutions, and
`solve_case(load_case("example1"))` solves a case file. On several ranks Python's garbage collector should be off, see
`collect_garbage`; what is collective here keeps it off while it runs.

Your own algorithm is a start and a rule; here Algorithm 1 as an example:

>>> def rule(p, flux, rho):
...     return np.where(flux > rho * p, Condition.ZERO_TRACE, Condition.NO_FLUX).astype(np.int8)
>>> mine = SetRule(start=Condition.NO_FLUX, rule=rule)
>>> other = solve(domain, boundary, problem, Options(algorithm=mine))
>>> bool(np.array_equal(other.contact_set().inside, solution.contact_set().inside))
True

Your own discretisation is a `Backend`: an object that solves one linear problem under given conditions on its sites.
With `FacetBackend` it needs `name`, `dofs`, `solver` and `solve`. Your own method is a `Method`, whose `run` gets a
`Task` and returns an `Outcome`. All of them are options: `Options(algorithm=…, backend=…)`.

Elastic contact has a problem and a boundary of its own. Here a block that is 0.1 above a foundation is pressed onto it:

>>> parts |= {"top": dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 1))}
>>> held = ElasticBoundary(contact=["bottom"], neumann=["right"])
>>> pressed = ElasticProblem(young=1.0, poisson=0.3, u_D=["0", "-0.3*y^2"], gap=0.1)
>>> body = solve_elastic(domain_of(mesh, parts), held, pressed)
>>> body.converged, body.norms()["contact_force"] > 0
(True, True)
>>> certify_elastic(body).relative < 0.3
True
"""

from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.parallel import collect_garbage
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.elastic_case import load_any_case
from signorini_fenicsx.cases.solving import adapt_case, evolve_case, solve_case
from signorini_fenicsx.certificate.adaptive import adapt
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.certificate.certify_elastic import certify_elastic
from signorini_fenicsx.certificate.step_bounds import StepBounds
from signorini_fenicsx.comparing.comparison import compare
from signorini_fenicsx.contact.backend import Backend, Iterate
from signorini_fenicsx.contact.conditions import Condition, Penalty, SiteConditions
from signorini_fenicsx.contact.history import Outcome, Step
from signorini_fenicsx.contact.laws import Corners, Friction, Graph, Law, Regulator, Signorini, TwoSided, Wall
from signorini_fenicsx.contact.set_rules import SetRule
from signorini_fenicsx.meshes.domain import Boundary, Domain
from signorini_fenicsx.meshes.own import domain_of
from signorini_fenicsx.methods.registry import METHODS, Method
from signorini_fenicsx.methods.task import Task
from signorini_fenicsx.output.checkpoint import load_any_solution, load_solution
from signorini_fenicsx.output.writing import write_solution
from signorini_fenicsx.physics.diffusion.data import Data
from signorini_fenicsx.physics.diffusion.evolution import Evolution
from signorini_fenicsx.physics.diffusion.facets import FacetBackend
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.spaces import Spaces
from signorini_fenicsx.physics.elasticity.problem import Coulomb, ElasticBoundary, ElasticProblem
from signorini_fenicsx.solving.elastic import solve_elastic
from signorini_fenicsx.solving.elastic_solution import ElasticSolution
from signorini_fenicsx.solving.evolving import Instant, evolve
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solution import Solution
from signorini_fenicsx.solving.solver import Solver, solve

__all__ = [
    "METHODS",
    "Backend",
    "Boundary",
    "Condition",
    "Corners",
    "Coulomb",
    "Data",
    "Domain",
    "ElasticBoundary",
    "ElasticProblem",
    "ElasticSolution",
    "Evolution",
    "FacetBackend",
    "Friction",
    "Graph",
    "InputError",
    "Instant",
    "Iterate",
    "Law",
    "Method",
    "NumericalFailure",
    "Options",
    "Outcome",
    "Penalty",
    "Problem",
    "Regulator",
    "SetRule",
    "Signorini",
    "SiteConditions",
    "Solution",
    "Solver",
    "Spaces",
    "Step",
    "StepBounds",
    "Task",
    "TwoSided",
    "Wall",
    "adapt",
    "adapt_case",
    "certify",
    "certify_elastic",
    "collect_garbage",
    "compare",
    "domain_of",
    "evolve",
    "evolve_case",
    "load_any_case",
    "load_any_solution",
    "load_case",
    "load_solution",
    "solve",
    "solve_case",
    "solve_elastic",
    "write_solution",
]
