"""Contact problems from Python: your own mesh, numbers, texts, UFL or functions for the data.

>>> import dolfinx.mesh, numpy as np, ufl
>>> from mpi4py import MPI
>>> mesh = dolfinx.mesh.create_unit_square(MPI.COMM_WORLD, 8, 8)
>>> x = ufl.SpatialCoordinate(mesh)
>>> walls = {"bottom": lambda x: np.isclose(x[1], 0), "right": lambda x: np.isclose(x[0], 1)}
>>> walls |= {"top": lambda x: np.isclose(x[1], 1), "left": lambda x: np.isclose(x[0], 0)}
>>> domain = domain_of(mesh, walls)
>>> unilateral = Signorini("bottom", psi=lambda x: 0.1 * x[0] - 0.05)
>>> problem = Diffusion(f=40 * (x[0] - 0.6), kappa="1 + y^2", conditions=[unilateral, Neumann("right")])
>>> solution = solve(domain, problem)
>>> solution.converged, solution.contact.facets
(True, 4)

On parts that no condition names u is `u_D`, by default 0. With mesh tags, `domain_of(mesh, {"wall": tags.find(3)})`.
The data are numbers, texts as in a case file, UFL on the mesh, functions of a finite element space or of points; κ may
be a table by region.

>>> solution.certify().relative < 0.3
True

A problem in time gives one solution after another:

>>> falling = Diffusion(f="-20*t", conditions=[Signorini("bottom", psi=-0.05), Neumann("right")])
>>> [instant.solution.contact.facets for instant in evolve(domain, falling, Evolution(end=0.4, steps=2))]
[8, 8]

There are other laws, and a condition may be on several parts:

>>> laws = [Friction("right", g="0.2*y"), Wall("bottom", beta=2), Dirichlet(["left", "top"], "0.1*y")]
>>> sliding = Diffusion(f=40 * (x[0] - 0.6), conditions=laws)
>>> {part: list(segments) for part, segments in solve(domain, sliding).segments_of_parts().items()}
{'right': ['slip+', 'stick', 'slip-'], 'bottom': ['inflow', 'closed']}

Your own law, algorithm and discretisation are in `signorini_fenicsx.extend`.

A solution gives values at points and fluxes, writes the files of the command line and draws itself in a notebook:

>>> solution.at([[0.5, 0.25]]).sigma.shape, round(solution.flux_through("bottom"), 3)
((1, 2), 0.706)

`adapt` refines where the bound finds the error. Data in UFL must be written on each mesh, by a function that solves:

>>> def solve_on(domain, start):
...     x = ufl.SpatialCoordinate(domain.mesh)
...     return solve(domain, Diffusion(f=40 * (x[0] - 0.6), conditions=[Signorini("bottom")]), start=start)
>>> finer, certificate = adapt(domain, solve_on, max_cells=500)
>>> numbers_and_texts = Diffusion(f="40*(x - 0.6)", conditions=[Signorini("bottom")])
>>> finer, certificate = adapt(domain, numbers_and_texts, max_cells=500)

`load_solution` reads a solution that was written, `compare` compares two solutions, and
`solve_case(load_case("example1"))` solves a case file. On several ranks Python's garbage collector should be off, see
`collect_garbage`; what is collective here keeps it off while it runs.

Elastic contact is solved, bounded, drawn and written by the same names. Here a block that is 0.1 above a foundation is
pressed onto it:

>>> conditions = [Contact("bottom", gap=0.1), Dirichlet("top", ["0", "-0.3"]), Neumann(["left", "right"])]
>>> body = solve(domain, Elasticity(young=1.0, poisson=0.3, conditions=conditions))
>>> body.converged, body.contact.facets, body.certify().relative < 0.3
(True, 8, True)
>>> body.at([[0.5, 0.25]]).sigma.shape
(1, 2, 2)
"""

from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.parallel import collect_garbage
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import adapt_case, evolve_case, solve_case
from signorini_fenicsx.certificate.adaptive import adapt
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.certificate.step_bounds import StepBounds
from signorini_fenicsx.comparing.comparison import compare
from signorini_fenicsx.contact.law import Film
from signorini_fenicsx.contact.laws import (
    Corners,
    Dirichlet,
    Friction,
    Neumann,
    Obstacle,
    Reaction,
    Regulator,
    River,
    Seepage,
    Signorini,
    Storage,
    TwoSided,
    Wall,
)
from signorini_fenicsx.discrete.pairs import Pair, Tied
from signorini_fenicsx.meshes.bodies import domain_of_bodies
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.physics.diffusion.problem import Diffusion
from signorini_fenicsx.physics.diffusion.soils import BrooksCorey, Gardner, VanGenuchten
from signorini_fenicsx.physics.elasticity.conditions import Contact, Coulomb, Tresca
from signorini_fenicsx.physics.elasticity.problem import Elasticity, Pressure, Support
from signorini_fenicsx.physics.stokes.problem import Leak, Outflow, Slip, Stokes
from signorini_fenicsx.solution import Solution
from signorini_fenicsx.solving.evolution import Evolution
from signorini_fenicsx.solving.evolving import evolve
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import Solver, solve

__all__ = [
    "BrooksCorey",
    "Contact",
    "Corners",
    "Coulomb",
    "Diffusion",
    "Dirichlet",
    "Domain",
    "Elasticity",
    "Evolution",
    "Film",
    "Friction",
    "Gardner",
    "InputError",
    "Leak",
    "Neumann",
    "NumericalFailure",
    "Obstacle",
    "Options",
    "Outflow",
    "Pair",
    "Pressure",
    "Reaction",
    "Regulator",
    "River",
    "Seepage",
    "Signorini",
    "Slip",
    "Solution",
    "Solver",
    "StepBounds",
    "Stokes",
    "Storage",
    "Support",
    "Tied",
    "Tresca",
    "TwoSided",
    "VanGenuchten",
    "Wall",
    "adapt",
    "adapt_case",
    "certify",
    "collect_garbage",
    "compare",
    "domain_of",
    "domain_of_bodies",
    "evolve",
    "evolve_case",
    "load_case",
    "load_solution",
    "solve",
    "solve_case",
]
