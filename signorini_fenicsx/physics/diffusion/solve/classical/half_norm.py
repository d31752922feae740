"""A discrete H^{1/2}(Γ_S) inner product on Λ_h, its Riesz map and its projection onto p ≥ 0.

The facet Laplacian K has a two-point flux between facets that share a vertex (2D) or an edge (3D), and p = 0 beyond the
end of Γ_S, as in H_00^{1/2}. With the mass matrix M = diag(|e|) and L = |Ω|^(1/d),

    H = M^{1/2} (M^{-1/2} K M^{-1/2} + L⁻²)^{1/2} M^{1/2},

where the square root is computed by eigenvectors. H, like K, has no positive entry off its diagonal, because the square
root of an M-matrix is an M-matrix. So the primal-dual active set method for the projection ends after finitely many
steps.
"""

import itertools
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import scipy.linalg

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.parallel import on_root, on_root_only
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solve.classical.gathered import RootRows


class HalfNorm:
    """(p, q)_H = pᵀHq on distributed facet arrays; dense algebra on rank 0. All methods are collective."""

    def __init__(self, spaces: Spaces):
        """Gather the facets and take the square root."""
        mesh = spaces.mesh
        dim = mesh.topology.dim
        self._rows = RootRows(mesh.comm, len(spaces.facets))
        mesh.topology.create_connectivity(dim - 1, dim)
        nodes = dolfinx.mesh.entities_to_geometry(mesh, dim - 1, spaces.facets).reshape(-1, dim)
        own = mesh.geometry.input_global_indices[nodes], mesh.geometry.x[nodes], spaces.facet_measure
        columns: list[Any] = [self._rows.gather(each) for each in own]
        self._alone = on_root_only(mesh.comm, lambda: _Dense(spaces.length, *columns))

    def inner(self, p: Array, q: Array) -> float:
        """(p, q)_H."""
        return on_root(self._rows.comm, self._action(_Dense.inner, p, q))

    def riesz(self, flux: Array) -> Array:
        """Rg, the p with (p, q)_H = (g, q) on Γ_S for all q."""
        return self._rows.scatter(on_root_only(self._rows.comm, self._action(_Dense.riesz, flux)))

    def project(self, p: Array, flux: Array) -> Array:
        """The H-projection of p − R flux onto q ≥ 0: the minimiser of ½qᵀHq − qᵀ(Hp − M flux) over q ≥ 0."""
        return self._rows.scatter(on_root_only(self._rows.comm, self._action(_Dense.project, p, flux)))

    def _action[T](self, method: Callable[..., T], *columns: Array) -> Callable[[], T]:
        """What rank 0 makes of some arrays by a method of `_Dense`."""
        rows = self._rows.gather(np.column_stack(columns))
        return lambda: method(self._alone, *([] if rows is None else rows.T))


class _Dense:
    """H of all facets, and what `HalfNorm` does, on one rank."""

    def __init__(self, length: float, vertices: npt.NDArray[np.int64], corners: Array, measure: Array):
        laplacian = _facet_laplacian(vertices, corners)
        root, self._measure = np.sqrt(measure), measure
        values, vectors = np.linalg.eigh(laplacian / np.outer(root, root) + np.eye(len(root)) / length**2)
        self._matrix = root[:, None] * ((vectors * np.sqrt(values)) @ vectors.T) * root
        self._factor = scipy.linalg.cho_factor(self._matrix)
        self._free = np.ones(len(root), dtype=bool)

    def inner(self, p: Array, q: Array) -> float:
        return float(p @ self._matrix @ q)

    def riesz(self, flux: Array) -> Array:
        return scipy.linalg.cho_solve(self._factor, self._measure * flux)

    def project(self, p: Array, flux: Array) -> Array:
        """The projection, by a primal-dual active set that starts from the last free set.

        There q = 0 or Hq = b, until both q and Hq − b are ≥ 0.
        """
        matrix, b = self._matrix, self._matrix @ p - self._measure * flux
        q = np.zeros_like(b)
        for _ in range(len(b) + 1):
            free = self._free
            q = np.zeros_like(b)
            q[free] = scipy.linalg.solve(matrix[np.ix_(free, free)], b[free], assume_a="pos")
            reaction = np.where(free, 0.0, matrix @ q - b)
            self._free = q - reaction > 0
            if np.array_equal(self._free, free):
                break
        return np.maximum(q, 0.0)


def _facet_laplacian(vertices: npt.NDArray[np.int64], corners: Array) -> Array:
    """K, from the vertex numbers, shape (facets, d), and the corners of each facet, shape (facets, d, 3)."""
    size, dim = vertices.shape
    middle = corners.mean(axis=1)
    ridges = defaultdict(list)  # facets around each vertex (2D) or edge (3D), with its place and measure
    for facet, local in itertools.product(range(size), itertools.combinations(range(dim), dim - 1)):
        points = corners[facet, list(local)]
        measure = float(np.linalg.norm(points[-1] - points[0])) if dim == 3 else 1.0
        ridges[tuple(sorted(vertices[facet, list(local)].tolist()))].append((facet, points.mean(axis=0), measure))
    laplacian = np.zeros((size, size))
    for around in ridges.values():
        distance = sum(float(np.linalg.norm(middle[facet] - place)) for facet, place, _ in around)
        conductance = around[0][2] / distance
        for facet, _, _ in around:
            laplacian[facet, facet] += conductance
        for (one, _, _), (two, _, _) in itertools.permutations(around, 2):
            laplacian[one, two] -= conductance
    return laplacian
