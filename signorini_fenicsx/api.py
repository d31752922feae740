"""Signorini problems from Python: a mesh and UFL of one's own, own set rules, own discretisations.

>>> import dolfinx.mesh, numpy as np, ufl
>>> from mpi4py import MPI
>>> mesh = dolfinx.mesh.create_unit_square(MPI.COMM_WORLD, 8, 8, ghost_mode=dolfinx.mesh.GhostMode.none)
>>> x = ufl.SpatialCoordinate(mesh)
>>> walls = {"bottom": lambda x: np.isclose(x[1], 0), "right": lambda x: np.isclose(x[0], 1)}
>>> parts = {name: dolfinx.mesh.locate_entities_boundary(mesh, 1, where) for name, where in walls.items()}
>>> problem = Problem(f=40 * (x[0] - 0.6), kappa=1 + x[1] ** 2, psi=lambda x: 0.1 * x[0] - 0.05)
>>> solution = solve_on(mesh, problem, parts=parts, signorini=["bottom"], neumann=["right"])
>>> solution.converged, solution.contact()[0]
(True, 4)

The rest of the boundary is Γ_D. With mesh tags, `parts = {"wall": tags.find(3)}`. The data are numbers, UFL on the
mesh, functions of a finite element space or of points, see `Problem`; κ may be a table by region.
`signorini_fenicsx.certificate.certify.certify` bounds the error, and
`signorini_fenicsx.output.writing.write_solution` writes the files of the command line.

An algorithm of one's own is a start and a rule; here Algorithm 1, in words:

>>> def rule(p, flux, rho):
...     return np.where(flux > rho * p, Condition.ZERO_TRACE, Condition.NO_FLUX).astype(np.int8)
>>> mine = Algorithm("contact where the flux wins", "docstring", Condition.NO_FLUX, rule)
>>> other = solve_on(mesh, problem, parts=parts, signorini=["bottom"], neumann=["right"], algorithm=mine)
>>> bool(np.array_equal(other.conditions.kind, solution.conditions.kind))
True

A discretisation of one's own is a `Backend`: an object that solves one linear problem under given facet conditions.
"""

from collections.abc import Callable, Mapping, Sequence

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.backends.contract import Backend, Iterate
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.cases.case import Boundary, Case, Geometry, ProblemTexts, Solve
from signorini_fenicsx.discrete.conditions import Condition, FacetConditions
from signorini_fenicsx.discrete.data import Data, Problem
from signorini_fenicsx.discrete.spaces import Spaces
from signorini_fenicsx.meshes.domain import AXES, Domain, axis_part, bounding_box, largest_diameter
from signorini_fenicsx.meshes.meshing import OWN_BEND
from signorini_fenicsx.methods.loop import Step
from signorini_fenicsx.methods.registry import Algorithm
from signorini_fenicsx.solving.solution import Solution
from signorini_fenicsx.solving.solver import solve

__all__ = [
    "Algorithm",
    "Backend",
    "Condition",
    "Data",
    "FacetConditions",
    "InputError",
    "Iterate",
    "NumericalFailure",
    "Problem",
    "Solution",
    "Solve",
    "Spaces",
    "solve_on",
]

type Facets = npt.NDArray[np.int32]


def solve_on(
    mesh: dolfinx.mesh.Mesh,
    problem: Problem,
    *,
    parts: Mapping[str, Facets],
    signorini: Sequence[str],
    neumann: Sequence[str] = (),
    regions: Mapping[str, npt.NDArray[np.int32]] | None = None,
    options: Solve | None = None,
    algorithm: Algorithm | None = None,
    backend: Callable[[Spaces, Data], Backend] | None = None,
    start: Solution | None = None,
    name: str = "problem",
    on_step: Callable[[Step], None] = lambda step: None,
) -> Solution:
    """Solve a Signorini problem on a mesh (collective).

    Args:
        mesh: Triangles or tetrahedra with straight edges, without ghost cells (`ghost_mode=GhostMode.none`).
        problem: The data.
        parts: Boundary facets of this rank by the name of their part; facets of other kinds are refused.
        signorini: Names of the parts of Γ_S.
        neumann: Names of the parts of Γ_N; the rest of the boundary is Γ_D.
        regions: Cells of this rank by the name of their region, for κ by region.
        options: Algorithm, backend, ρ, ε and so on as in the section `[solve]` of a case; its h is not used.
        algorithm: An algorithm of one's own, instead of that of the options.
        backend: Makes the discrete system from the spaces and the data, instead of that of the options.
        start: Solution whose contact set is taken for the first one.
        name: What results are called.
        on_step: Called on all ranks after each iteration.

    Raises:
        InputError: If mesh, parts or data cannot be used.
        NumericalFailure: If there is no convergence; its `solution` holds the last state.
    """
    domain = _domain(mesh, parts, regions or {})
    for key, names in {"signorini": signorini, "neumann": neumann}.items():
        unknown = [part for part in names if part not in parts]
        if unknown:
            raise InputError(f"{key}: unknown part '{unknown[0]}'; there are {', '.join(parts)}")
    case = Case.model_construct(
        name=name,
        geometry=Geometry.model_construct(shape=None, file=name),
        boundary=Boundary(signorini=list(signorini), neumann=list(neumann)),
        problem=ProblemTexts.model_construct(f="given in Python"),
        solve=options or Solve(),
    )
    _check_parts(domain, [*signorini, *neumann])
    return solve(
        case,
        domain=domain,
        problem=problem,
        algorithm=algorithm,
        backend=backend,
        start=start,
        on_step=on_step,
    )


def _domain(
    mesh: dolfinx.mesh.Mesh, parts: Mapping[str, Facets], regions: Mapping[str, npt.NDArray[np.int32]]
) -> Domain:
    """A mesh with its parts as the solver wants them (collective)."""
    topology = mesh.topology
    dim = topology.dim
    if mesh.basix_cell().name not in ("triangle", "tetrahedron") or mesh.geometry.cmaps[0].degree != 1:
        raise InputError("the mesh must consist of triangles or tetrahedra with straight edges")
    if dim != mesh.geometry.dim:
        raise InputError(f"the mesh is a surface in space: its cells have dimension {dim}, not {mesh.geometry.dim}")
    if mesh.comm.allreduce(topology.index_map(dim).num_ghosts > 0, MPI.LOR):
        raise InputError("the mesh has ghost cells; make it with ghost_mode=dolfinx.mesh.GhostMode.none")
    topology.create_connectivity(dim - 1, dim)
    facets = {part: np.unique(chosen).astype(np.int32) for part, chosen in parts.items()}
    labels = {part: axis_part(_longest_axis(mesh, chosen)) for part, chosen in facets.items()}
    box = bounding_box(mesh.geometry.x, mesh.comm)
    return Domain(mesh, largest_diameter(mesh), labels, facets, regions, OWN_BEND / float((box[1] - box[0]).max()))


def _longest_axis(mesh: dolfinx.mesh.Mesh, facets: Facets) -> str:
    """The coordinate along which a part extends most (collective)."""
    nodes = dolfinx.mesh.entities_to_geometry(mesh, mesh.topology.dim - 1, facets)
    low, high = bounding_box(mesh.geometry.x[nodes].reshape(-1, 3), mesh.comm)
    return AXES[int(np.argmax(high - low))]


def _check_parts(domain: Domain, names: Sequence[str]) -> None:
    """Refuse parts that are empty, overlap or lie inside the domain (collective)."""
    topology, comm = domain.mesh.topology, domain.mesh.comm
    free = np.zeros(topology.index_map(topology.dim - 1).size_local, dtype=bool)
    free[dolfinx.mesh.exterior_facet_indices(topology)] = True
    for name in names:
        facets = domain.facets[name]
        count, wrong = comm.allreduce(np.array([len(facets), np.count_nonzero(~free[facets])]))
        if count == 0:
            raise InputError(f"part '{name}' has no facet")
        if wrong > 0:
            raise InputError(f"part '{name}' has {wrong} facets that are inside the domain or in another part")
        free[facets] = False
