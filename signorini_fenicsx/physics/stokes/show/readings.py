"""What is read off a viscous flow, in its words: speed and pressure, u_n and σ_nn along laws, flows."""

from typing import Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.tolerances import TIE
from signorini_fenicsx.discrete.linear_traces import opposite
from signorini_fenicsx.expressions.simplices import barycentric_gradients
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import reference, split_vertices, to_entries
from signorini_fenicsx.physics.elasticity.show.readings import largest_of


def pressure_of(stresses: Array) -> Array:
    """P = −tr σ/d at the vertices of the subcells."""
    return -np.einsum("nsaii->nsa", stresses) / stresses.shape[-1]


def traces(solution: Any) -> Array:
    """û at the vertices of the facets of each cell of this rank, shape (cells, d + 1, d, d) (collective).

    On a cell û − u_h is given by ⟨û − u_h, τn⟩ = (𝔸σ_h − ε(u_h), τ) for all stresses τ of the element. û is one field
    on a facet of two cells up to the residuals, and ∫ û·n over the boundary of a cell is 0.
    """
    spaces, dim = solution.spaces, solution.spaces.dim
    element, u = reference(dim), spaces.displacement_values(solution.u)
    found: Array = u[:, opposite(dim)]
    for cells in spaces.blocks():
        numbers, masses = cells.numbers, solution.data.masses(spaces, cells)
        basis = cells.stresses(element.stresses)
        stress = to_entries(solution.stresses[numbers])
        strained = (masses @ stress.reshape(*masses.shape[:3], 1)).reshape(stress.shape)
        strain = to_entries(np.einsum("nvi,nvj->nij", u[numbers], barycentric_gradients(cells.vertices)))
        strained -= (cells.measure / (dim + 1) ** 2)[:, None, None, None] * strain[:, None, None]
        left = np.einsum("nve,nveb->nb", strained.reshape(len(numbers), (dim + 1) ** 2, -1), basis)
        pulls = cells.tractions(element.tractions).swapaxes(1, 2)
        found[numbers] += (np.linalg.pinv(pulls) @ left[:, :, None]).reshape(-1, dim + 1, dim, dim)
    return found


def velocities(solution: Any, at_facets: Array) -> Array:
    """The field of BDM1 with the normal components û·n, at the vertices of each cell, shape (cells, d + 1, d).

    It is linear on cells, its divergence is 0, and u·n is the same on both sides of a facet: its lines do not end.

    Args:
        solution: The solution.
        at_facets: û as `traces` gives it.
    """
    dim = solution.spaces.dim
    normals = -barycentric_gradients(solution.spaces.vertices)  # along those of the facets opposite to the vertices
    found = np.empty((len(normals), dim + 1, dim))
    for vertex in range(dim + 1):
        facets = [facet for facet in range(dim + 1) if facet != vertex]
        at = [vertex - (vertex > facet) for facet in facets]
        right = np.einsum("nfi,nfi->nf", normals[:, facets], at_facets[:, facets, at])
        found[:, vertex] = np.linalg.solve(normals[:, facets], right[:, :, None])[:, :, 0]
    return found


def quantities(solution: Any) -> dict[str, Any]:
    """The numbers of `quantities` in the summary (collective)."""
    spaces, stresses = solution.spaces, solution.stresses
    comm, dim = spaces.mesh.comm, spaces.dim
    speed = np.linalg.norm(spaces.displacement_values(solution.u), axis=2).ravel()
    pressure, places = pressure_of(stresses).ravel(), split_vertices(spaces.vertices).reshape(-1, dim)
    rounding = TIE * comm.allreduce(float(np.abs(stresses).max(initial=0.0)), MPI.MAX)
    normal = np.where(np.abs(solution.pressure) > rounding, solution.pressure, 0.0)
    return {
        "speed": largest_of(comm, speed, spaces.vertices.reshape(-1, dim)),
        "pressure": ends_of(comm, pressure, places),
        "balance": solution.balance[1],
        "laws": {
            name: {
                "u_n": ends_of(comm, solution.linear_gap[rows].ravel(), spaces.contact.vertices[rows].reshape(-1, dim)),
                "sigma_nn": ends_of(comm, normal[rows].ravel(), spaces.contact.vertices[rows].reshape(-1, dim)),
                "normal_force": comm.allreduce(float(spaces.contact.measure[rows] @ normal[rows].mean(axis=1))),
            }
            for name in spaces.part_names
            for rows in [spaces.rows_on(name)]
        },
    }


def ends_of(comm: MPI.Comm, values: Array, places: Array) -> dict[str, Any]:
    """The largest and the least value with their places: {} if there is none (collective)."""
    largest, least = (largest_of(comm, sign * values, places) for sign in (1, -1))
    return largest and {**largest, "least": -least["largest"], "least_at": least["at"]}
