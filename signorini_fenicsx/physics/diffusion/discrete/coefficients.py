"""κ and c on a mesh: the data as given, their means over the cells, and what is refused."""

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import function_of, owned_cells, owned_values
from signorini_fenicsx.base.text import place_in_words
from signorini_fenicsx.discrete.data_values import check_cells, least_value
from signorini_fenicsx.discrete.datum import Datum, conductivity_of, quadrature_degree, regional_datum
from signorini_fenicsx.discrete.points import cell_quadrature
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.problem import Problem

ROUNDING = 1e-12
"""Relative asymmetry of κ, or size of a c < 0, that counts as rounding."""
TINY = 1e-6
"""Points where κ ≤ 0 are looked for where κ may be below this share of its mean."""


def mean_eigenvalues(spaces: Spaces, kappa: Datum, kappa_h: fem.Function | fem.Constant) -> Array:
    """Mean eigenvalue of κ_h on each owned cell."""
    if kappa.number is not None:
        return np.full(len(spaces.cell_measures), kappa.number)
    shape = kappa.shape or (1, 1)
    return np.trace(owned_values(kappa_h).reshape(-1, *shape), axis1=1, axis2=2) / shape[0]


def conductivity(spaces: Spaces, problem: Problem) -> tuple[Datum, fem.Function | fem.Constant, float]:
    """The datum κ, κ_h and the conductance (collective)."""
    kappa = conductivity_of(spaces, problem.kappa)
    kappa_h = _projected_conductivity(spaces, kappa)
    integral = spaces.cell_measures @ mean_eigenvalues(spaces, kappa, kappa_h)
    return kappa, kappa_h, spaces.mesh.comm.allreduce(integral) / spaces.length ** (spaces.mesh.geometry.dim + 1)


def _projected_conductivity(spaces: Spaces, kappa: Datum) -> fem.Function | fem.Constant:
    """κ_h (collective)."""
    means = cell_means(spaces, kappa)
    check_cells("kappa", means, spaces)
    matrices = means.reshape(len(means), *(kappa.shape or (1, 1)))
    size = np.abs(matrices).max(axis=(1, 2))
    symmetric = np.abs(matrices - matrices.transpose(0, 2, 1)).max(axis=(1, 2)) <= ROUNDING * size
    comm = spaces.mesh.comm
    if not comm.allreduce(bool(symmetric.all()), MPI.LAND):
        raise InputError("[problem] kappa: is not symmetric everywhere")
    positive = np.linalg.eigvalsh(matrices)[:, 0]
    smallest, what = comm.allreduce(float(positive.min(initial=np.inf)), MPI.MIN), "a mean over a cell"
    place: tuple[float, ...] = ()
    if smallest > 0 and kappa.number is None:
        smallest, place = least_value(spaces, kappa, TINY * positive)
        what = "its value"
    if not smallest > 0:
        what = f"{what} has the eigenvalue" if kappa.shape else f"{what} is"
        raise InputError(f"[problem] kappa: must be positive; {what} {smallest:.3g}{_near(place)}")
    if kappa.number is not None:
        return fem.Constant(spaces.mesh, kappa.number)
    return function_of(spaces.Q_matrix if kappa.shape else spaces.Q, means.ravel(), "kappa_h")


def reaction(spaces: Spaces, problem: Problem) -> tuple[Datum, fem.Function | None]:
    """The datum c, and c_h or None if it is 0 (collective)."""
    c = regional_datum(spaces, "c", problem.c)
    if c.number == 0:
        return c, None
    comm = spaces.mesh.comm
    means = cell_means(spaces, c)
    c_h = function_of(spaces.Q, means, "c_h")
    check_cells("c", means, spaces)
    rounding = ROUNDING * comm.allreduce(float(np.abs(means).max(initial=0.0)), MPI.MAX)
    least, place = least_value(spaces, c, np.full(len(means), -rounding))
    if least < -rounding:
        raise InputError(f"[problem] c: must not be negative; it is {least:.3g}{_near(place)}")
    return c, c_h if comm.allreduce(bool(means.any()), MPI.LOR) else None


def _near(place: tuple[float, ...]) -> str:
    """A place in the words of a message."""
    return f" near {place_in_words(place)}" if place else ""


def cell_means(spaces: Spaces, datum: Datum, degree: int | None = None) -> Array:
    """Mean on each cell of this rank, shape (cells, *shape), by quadrature of this degree or its own (collective)."""
    cells = owned_cells(spaces.mesh)
    if datum.number is not None:
        return np.full(len(cells), datum.number)
    blocks = cell_quadrature(spaces.mesh, cells, degree or quadrature_degree(datum))
    return np.concatenate([points.means(datum.values(points)) for points in blocks])
