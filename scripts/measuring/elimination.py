"""The facet system of RT0 by its closed form and by the elimination of its cells: the same matrix, and the seconds."""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import time
from collections.abc import Iterator
from typing import Annotated

import numpy as np
import typer
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.owned import cell_dofs, owned_values
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.discrete.cell_shapes import arms, corners
from signorini_fenicsx.discrete.hybrid_system import eliminate
from signorini_fenicsx.discrete.linear_traces import blocks_of_cells, facet_normals
from signorini_fenicsx.discrete.matrices import OfCells
from signorini_fenicsx.physics.diffusion.discrete.data import Data, project_data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces, build_spaces
from signorini_fenicsx.physics.diffusion.solve.facet_system import FacetSystem


def elimination(
    case: Annotated[str, typer.Argument(help="A shipped case.")] = "example1",
    h: Annotated[float, typer.Option(help="Size of its cells.")] = 0.005,
    times: Annotated[int, typer.Option(min=1, help="The least of so many.")] = 5,
) -> None:
    """Print the seconds to assemble the system with another κ, by both ways, and by how much they differ."""
    given = load_case(case).with_values({"solve.h": h})
    domain = mesh_case(given, MPI.COMM_SELF)
    spaces = build_spaces(domain, given.boundary.signorini, given.boundary.neumann)
    data = project_data(spaces, given.posed(domain.mesh.geometry.dim))
    system, seconds = FacetSystem(spaces, data), {"closed form": list[float](), "elimination": list[float]()}
    for _ in range(times):
        clock = [time.process_time()]
        system._assemble_again()
        clock.append(time.process_time())
        found = eliminated(system, data)
        for each, spent in zip(seconds.values(), np.diff([*clock, time.process_time()]), strict=True):
            each.append(spent)
    found.axpy(-1.0, system.matrix)
    of_both = ", ".join(f"{way} {min(each):.3f} s" for way, each in seconds.items())
    print(f"{len(spaces.cell_measures)} cells: {of_both}; difference {found.norm() / system.matrix.norm():.1e}")


def eliminated(system: FacetSystem, data: Data) -> PETSc.Mat:
    """The matrix of a facet system by elimination (collective)."""
    return system.sum_of(cells(system.spaces, data))


def cells(spaces: Spaces, data: Data) -> Iterator[OfCells]:
    """The cells after elimination: fluxes that are constant, and (x − x_T)/(d|T|) for the one with a divergence."""
    mesh, dim, dofs = spaces.mesh, spaces.mesh.topology.dim, cell_dofs(spaces.crouzeix_raviart)
    inverses = np.broadcast_to(np.linalg.inv(data.matrices(spaces)), (len(dofs), dim, dim))
    c = np.zeros(len(dofs)) if data.c_h is None else owned_values(data.c_h)
    for numbers in blocks_of_cells(mesh):
        measure, arm, inverse = spaces.cell_measures[numbers], arms(mesh, numbers), inverses[numbers]
        tractions = np.full((len(numbers), dim + 1, dim + 1), 1 / (dim + 1))
        tractions[:, :, :dim] = facet_normals(corners(mesh, numbers))
        product = np.zeros_like(tractions)
        product[:, :dim, :dim] = measure[:, None, None] * inverse
        moments = np.einsum("nvi,nij,nvj->n", arm, inverse, arm) / ((dim + 1) * (dim + 2))
        product[:, dim, dim] = moments / (dim**2 * measure)
        reaction = (c[numbers] * measure)[:, None, None]
        block = eliminate(numbers, None, tractions, product, np.zeros((len(numbers), 1)), 0.0, reaction)
        yield dofs[numbers], block.matrix
