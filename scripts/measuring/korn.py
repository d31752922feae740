"""The constants of `physics/elasticity/bound/korn.py`, where the proof is that what is printed bounds them.

With rounding included, `rigorous/elasticity/loads.py` uses them. For all v, linear on the cells of a mesh of the
regular simplex and orthogonal to linear fields, stresses of Johnson and Mercier that balance Qv are found by least
squares in floats, made exact along a tree, and enclosed. Their norms are ≤ c_h‖v‖ if c_h²(v, v') − (τ(v), τ(v')) is
positive definite, which is so if it is near the unit matrix after a change of the basis. Likewise for tractions. All is
done on the simplex with vertices 0, e_1, …, by the map of Piola.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

from collections.abc import Callable
from typing import Annotated

import numpy as np
import scipy.sparse as sp
import typer
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.certificate.passed_on import kuhn_lattice
from signorini_fenicsx.discrete.hybrid_system import Eliminated, eliminate, responses
from signorini_fenicsx.discrete.linear_traces import facet_normals, opposite
from signorini_fenicsx.expressions.intervals import Interval, enclosing, stacked
from signorini_fenicsx.physics.elasticity.bound.korn import KORN, TRACE, regular_simplex, stretch
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import (
    Cells,
    compliance_product,
    hats_in_subcells,
    reference,
)
from signorini_fenicsx.physics.elasticity.discrete.tools import rigid_motions
from signorini_fenicsx.rigorous.discrete import MeshCells as EnclosedCells
from signorini_fenicsx.rigorous.elasticity.loads import MOMENTS, PROVED
from signorini_fenicsx.rigorous.elasticity.stress import along_tree, solved, stresses_of, wrench_of_moments, wrenches
from signorini_fenicsx.rigorous.simplices import root, simplices, total


def korn(
    plane: Annotated[int, typer.Option(min=2, help="Cells along an edge of the triangle.")] = 32,
    space: Annotated[int, typer.Option(min=8, help="Cells along an edge of the tetrahedron.")] = 16,
) -> None:
    """Print c_h and t_h, their bounds, and the numbers that the program uses."""
    for dim, parts in ((2, plane), (3, space)):
        c_h, bound = korn_constant(dim, parts)
        print(f"d = {dim}, {parts} cells along an edge: c_h = {c_h:.4f}, ĉ ≤ {bound:.4f}; in use {KORN[dim]}")
        t_h, bound = trace_constant(dim, parts)
        print(f"d = {dim}, {parts} cells along an edge: t_h = {t_h:.4f}, t̂ ≤ {bound:.4f}; in use {TRACE[dim]}")


def korn_constant(dim: int, parts: int) -> tuple[float, float]:
    """c_h and the bound of ĉ."""
    vertices, cells = regular_lattice(dim, parts)
    c_h = np.sqrt(largest_eigenvalue(vertices, cells))
    s = stretch(Cells(vertices[cells]).derivative).max()
    q = moment_error(dim)
    return c_h, bound_of(c_h, s, q)


def trace_constant(dim: int, parts: int) -> tuple[float, float]:
    """t_h and the bound of t̂."""
    t_h = np.sqrt(largest_eigenvalue_of_tractions(*regular_lattice(dim, parts)))
    return t_h, t_h / np.sqrt(1 - 1 / parts)


def bound_of(c_h: float, s: float, q: float) -> float:
    """The bound of ĉ that `physics/elasticity/bound/korn.py` proves."""
    rest = 1 - s**2 * (1 + q**2)
    return c_h * (s * q + np.sqrt(1 - s**2)) / rest if rest > 0 else np.inf


def lattice(dim: int, parts: int) -> tuple[Array, Indices]:
    """A mesh of the simplex with vertices 0, e_1, …, by that of Kuhn's; octahedra are cut along parallel diagonals."""
    places = kuhn_lattice(dim, parts)
    points = -np.diff(places, axis=2, append=0).reshape(-1, dim) / parts
    points, numbers = np.unique(points, axis=0, return_inverse=True)
    return points, np.sort(numbers.reshape(len(places), dim + 1), axis=1)


def regular_lattice(dim: int, parts: int) -> tuple[Array, Indices]:
    """A mesh of the regular simplex."""
    points, numbers = lattice(dim, parts)
    return points @ regular_simplex(dim).T, numbers


def largest_eigenvalue(vertices: Array, numbers: Indices) -> float:
    """c_h² of a mesh.

    With unknowns x of the traces, as in `physics/elasticity/solve/system.py`, and moments m of the load, the stress has
    the norm ½‖τ‖² = max over x of ½ m·Cm + x·Rm − ½ x·Kx.
    """
    cells = Cells(vertices[numbers])
    dim, count = cells.dim, len(numbers)
    size = (dim + 1) * dim
    balance = -np.kron(np.eye(dim + 1), np.linalg.inv(cells.derivative))
    products, eliminated = _eliminated(cells)
    alone = balance.transpose(0, 2, 1) @ responses(products, size)[1] @ balance
    _, _, unknowns, solve = _system_of_traces(vertices, numbers, eliminated.matrix)
    of_loads = -eliminated.u.transpose(0, 2, 1) @ balance
    right = _assembled(of_loads, unknowns, np.arange(count * size).reshape(count, size))

    def response(m: Array) -> Array:
        mine = np.einsum("nij,nj->ni", alone, m)
        moved: Array = mine + (right.T @ solve(right @ m.ravel())).reshape(count, size)
        return moved

    return _largest(cells.vertices, cells.measure, response)


def largest_eigenvalue_of_tractions(vertices: Array, numbers: Indices) -> float:
    """t_h² of a mesh, for the facet of the simplex on which the last coordinate is 0."""
    cells = Cells(vertices[numbers])
    dim, matrices = cells.dim, _eliminated(cells)[1].matrix
    facets, blocks, _, solve = _system_of_traces(vertices, numbers, matrices)
    on = np.flatnonzero((np.abs(vertices[facets][:, :, -1]) < 1e-12).all(axis=1))
    cell, local = np.divmod([int(np.argmax(blocks == facet)) for facet in on], dim + 1)
    measures = np.linalg.norm(facet_normals(cells.vertices)[cell, local], axis=1)

    def response(m: Array) -> Array:
        load = np.zeros((len(facets), dim**2))
        load[on] = m
        moved: Array = solve(load.ravel()).reshape(load.shape)[on]
        return moved

    return _largest(vertices[facets[on]], measures, response)


def _eliminated(cells: Cells) -> tuple[Array, Eliminated]:
    """(τ, τ') of the basis on each cell, and what is left for the traces."""
    dim, element = cells.dim, reference(cells.dim)
    hats = (1 + np.eye(dim + 1)) / ((dim + 1) * (dim + 2))
    share = cells.measure[:, None, None, None] / (dim + 1)
    masses = share * np.kron(hats, np.eye(dim * (dim + 1) // 2))
    masses = np.broadcast_to(masses, (len(masses), dim + 1, *masses.shape[2:]))
    products = compliance_product(cells.stresses(element.stresses), masses)
    none = np.zeros((len(masses), dim * (dim + 1)))
    return products, eliminate(cells, cells.tractions(element.tractions), products, none)


def _system_of_traces(
    vertices: Array, numbers: Indices, matrices: Array
) -> tuple[Indices, Indices, Indices, Callable[[Array], Array]]:
    """Assemble and factorise; springs on one facet hold the body, and loads in equilibrium leave them alone.

    Returns:
        The vertices of each facet; the facets and the unknowns of each cell; the solver.
    """
    count, dim = len(numbers), numbers.shape[1] - 1
    facets, blocks = np.unique(numbers[:, opposite(dim)].reshape(-1, dim), axis=0, return_inverse=True)
    unknowns = (blocks.reshape(count, dim + 1, 1) * dim**2 + np.arange(dim**2)).reshape(count, -1)
    held = rigid_motions(vertices[facets[0]]).reshape(dim**2, -1)
    cell, local = divmod(int(np.argmin(blocks)), dim + 1)  # where the first facet is
    block = slice(local * dim**2, (local + 1) * dim**2)
    matrices[cell, block, block] += held @ held.T
    matrix, symmetric = _assembled(matrices, unknowns, unknowns).tocsc(), {"SymmetricMode": True}
    factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
    return facets, blocks.ravel(), unknowns, factors.solve


def _largest(vertices: Array, measures: Array, response: Callable[[Array], Array]) -> float:
    """The largest ⟨v, response to v⟩/‖v‖² of v that are linear on simplices and orthogonal to what is linear on all.

    Args:
        vertices: Of the simplices, shape (n, k, d).
        measures: Their measures.
        response: From moments of loads against the hats of the vertices, shape (n, k d), to displacements there.
    """
    count, corners, dim = vertices.shape
    hats = (1 + np.eye(corners)) / (corners * (corners + 1))
    root = np.kron(np.linalg.cholesky(hats), np.eye(dim))
    scale = np.sqrt(measures)[:, None]
    linear = np.concatenate([vertices, np.ones((count, corners, 1))], axis=2)
    linear = np.einsum("nvk,ij->nvikj", linear, np.eye(dim)).reshape(count, corners * dim, -1)
    linear = (root.T @ linear * scale[:, :, None]).reshape(count * corners * dim, -1)
    motions, sizes, _ = np.linalg.svd(linear, full_matrices=False)
    motions = motions[:, sizes > 1e-10 * sizes[0]]

    def apply(z: Array) -> Array:
        z = z - motions @ (motions.T @ z)
        image = (scale * (response(scale * (z.reshape(count, -1) @ root.T)) @ root)).ravel()
        return image - motions @ (motions.T @ image)

    operator = LinearOperator((len(motions), len(motions)), matvec=apply, dtype=np.float64)
    return float(eigsh(operator, k=1, which="LA", return_eigenvectors=False, tol=1e-6)[0])


def _assembled(blocks: Array, rows: Indices, columns: Indices) -> sp.csr_array:
    shape = blocks.shape
    places = np.broadcast_to(rows[:, :, None], shape).ravel(), np.broadcast_to(columns[:, None, :], shape).ravel()
    return sp.coo_array((blocks.ravel(), places)).tocsr()


def moment_error(dim: int) -> float:
    """The largest ‖p − Qp‖/‖p‖ of linear p; Qp is constant on each subcell and has the moments of p."""
    hats = (1 + np.eye(dim + 1)) / ((dim + 1) * (dim + 2))  # (φ_v, φ_w) for |T| = 1
    means = hats_in_subcells(dim)
    values = np.linalg.solve(means / (dim + 1), hats)  # of Qφ_w on the subcells
    difference = values.T @ values / (dim + 1) - hats  # p − Qp is orthogonal to p
    return float(np.sqrt(np.linalg.eigvals(np.linalg.solve(hats, difference)).real.max()))


LARGER = 1 + 1e-4
"""The bounds of c_h and t_h are larger by this factor than the floats found for them."""
MARGIN = 1e-6
"""That of the stretch of cells, which is computed in floats."""


def proved_korn(
    plane: Annotated[int, typer.Option(min=2, help="Cells along an edge of the triangle.")] = 4,
    space: Annotated[int, typer.Option(min=2, help="Cells along an edge of the tetrahedron.")] = 4,
) -> None:
    """Print proved bounds, rounding included, and those in use."""
    for dim, parts in ((2, plane), (3, space)):
        problem = Loaded(dim, parts)
        c_h, t_h = problem.constant(*problem.loads()), problem.constant(*problem.tractions())
        korn, trace = bound_of(c_h, problem.stretch + MARGIN, MOMENTS[dim]), t_h / np.sqrt(1 - 1 / parts)
        print(f"d = {dim}: c_h ≤ {c_h:.5f}, ĉ ≤ {korn:.5f}; t_h ≤ {t_h:.5f}, t̂ ≤ {trace:.5f}; in use {PROVED.get(dim)}")


class Loaded:
    """A mesh of the simplex, and what loads do to it."""

    def __init__(self, dim: int, parts: int):
        """Make the mesh."""
        points, numbers = lattice(dim, parts)
        self.dim = dim
        self.stretch = float(stretch(Cells((points @ regular_simplex(dim).T)[numbers]).derivative).max())
        facets = numbers[:, opposite(dim)].reshape(-1, dim)
        _, facet = np.unique(facets, axis=0, return_inverse=True)
        self.mesh = EnclosedCells(points[numbers], numbers, facet.reshape(len(numbers), dim + 1))
        self.cells = simplices(self.mesh.vertices)
        self.inside: Mask = np.bincount(facet)[self.mesh.facets] == 2
        third = [enclosing(1.0), enclosing(0.0), enclosing(0.0)]
        second = [enclosing(0.5), root(enclosing(3.0)) / 2.0, enclosing(0.0)]
        last = [enclosing(0.5), root(enclosing(3.0)) / 6.0, root(enclosing(2.0) / 3.0)]
        columns = [stacked(column[:dim]) for column in (third, second, last)[:dim]]
        self.map = stacked(columns, axis=1)  # from the simplex to the regular one

    def loads(self) -> tuple[Interval, Interval, Interval]:
        """Tractions and moments of a basis of the v, and the matrix of their products, times that of all |T|."""
        dim, cells = self.dim, self.cells
        hats = (1 + np.eye(dim + 1)) / ((dim + 1) * (dim + 2))
        values = self._orthogonal(self.mesh.vertices, cells.measure, hats)
        scaled = total(values[..., None, :] * hats, axis=-1)
        moments = scaled * cells.measure[:, None]
        none = enclosing(np.zeros((len(values.lo) * dim, *self.inside.shape, dim, dim)))
        return none, self._by_component(moments), self._products(values, moments)

    def tractions(self) -> tuple[Interval, Interval, Interval]:
        """Likewise of tractions on the facet where the last coordinate is 0."""
        dim, mesh = self.dim, self.mesh
        corners = mesh.vertices[:, opposite(dim)]
        cell, local = np.nonzero((corners[..., -1] == 0).all(axis=2))
        hats = (1 + np.eye(dim)) / (dim * (dim + 1))
        share = enclosing(np.full(len(cell), 1.0))
        values = self._orthogonal(corners[cell, local][..., :-1], share, hats)  # those of q on each facet
        scaled = total(values[..., None, :] * hats, axis=-1)
        on_facets = self._by_component(values)
        pulls = enclosing(np.zeros((len(on_facets.lo), *self.inside.shape, dim, dim)))
        pulls = pulls.put((slice(None), cell, local), on_facets)
        none = enclosing(np.zeros((len(on_facets.lo), *mesh.vertices.shape)))
        measure = {2: enclosing(1.0), 3: root(enclosing(3.0)) / 4.0}[dim] / float(len(cell))  # |e| of each facet
        volume = {2: root(enclosing(3.0)) / 2.0, 3: root(enclosing(2.0)) / 2.0}[dim]  # the determinant of the map
        return pulls, none, self._products(values, scaled) * (volume / measure)

    def _orthogonal(self, places: Array, share: Interval, hats: Array) -> Interval:
        """A basis of the functions, linear on simplices, orthogonal to linear ones: (basis, simplices, vertices)."""
        count, corners, _ = places.shape
        linear = np.concatenate([np.ones((count, corners, 1)), places], axis=2)
        weighted = total(enclosing(hats[..., None]) * linear[:, None], axis=2) * share[:, None, None]
        gram = total(total(weighted[..., None] * linear[:, :, None], axis=0), axis=0)
        others = weighted.reshape(count * corners, -1)[corners:]
        shares = solved(gram.on((len(others.lo), *gram.lo.shape)), others)
        part = total(shares[:, None, None] * linear)
        unit = np.eye(count * corners)[corners:].reshape(-1, count, corners)
        return enclosing(unit) - part

    def _by_component(self, values: Interval) -> Interval:
        """Each function in each component: (basis and component, simplices, vertices, d)."""
        components = values[:, None, :, :, None] * np.eye(self.dim)[:, None, None, :]
        return components.reshape(-1, *components.lo.shape[2:])

    def _products(self, values: Interval, weighted: Interval) -> Interval:
        """(v, v') of all pairs, after the map."""
        number = len(values.lo)
        scalar = product(values.reshape(number, -1), transposed(weighted.reshape(number, -1)))
        metric = total(self.map[:, :, None] * self.map[:, None], axis=0)
        return (scalar[:, None, :, None] * metric[None, :, None, :]).reshape(number * self.dim, -1)

    def constant(self, pulls: Interval, moments: Interval, norms: Interval) -> float:
        """A proved bound of the root of the largest (τ(v), τ(v))/(v, v)."""
        energies = self._energies(self._stresses(pulls, moments))
        energy, norm = middle(energies), middle(norms)
        lower = np.linalg.inv(np.linalg.cholesky(norm))
        most = float(np.linalg.eigvalsh(lower @ energy @ lower.T).max()) * LARGER**2
        left = norms * most - energies
        basis = np.linalg.inv(np.linalg.cholesky(middle(left))).T
        unit = product(enclosing(basis.T), product(left, enclosing(basis)))
        off = (unit - np.eye(len(basis))).largest.sum(axis=1).max() * (1 + 1e-9)
        assert off < 1
        return float(np.sqrt(most) * (1 + 1e-12))

    def _stresses(self, pulls: Interval, moments: Interval) -> Interval:
        """Stresses in balance with loads, of nearly the least norms, shape (loads, cells, d + 1, d + 1, d, d)."""
        mesh, dim, inside = self.mesh, self.dim, np.nonzero(self.inside)
        number = int(mesh.facets.max()) + 1
        _, first = np.unique(mesh.facets, return_index=True)
        sign = np.full(self.inside.size, -1.0)
        sign[first] = 1.0
        sign = sign.reshape(self.inside.shape)[inside]
        unit = np.eye(number * dim * dim).reshape(-1, number, dim, dim)
        units = np.zeros((len(unit), *self.inside.shape, dim, dim))
        units[:, inside[0], inside[1]] = unit[:, mesh.facets[inside]] * sign[:, None, None]
        units = units[units.any(axis=(1, 2, 3, 4))]
        none = np.zeros((len(units), *mesh.vertices.shape))
        of_units, wrench_of_units = self._floats(enclosing(units), enclosing(none))
        own, wrench = self._floats(pulls, moments)
        zero = np.zeros((wrench_of_units.shape[1],) * 2)
        matrix = np.block([[of_units @ of_units.T, wrench_of_units], [wrench_of_units.T, zero]])
        right = np.concatenate([-of_units @ own.T, -wrench.T])
        shares = np.linalg.lstsq(matrix, right, rcond=1e-12)[0][: len(units)]
        near = np.einsum("un,ucfai->ncfai", shares, units, optimize=True)
        origin, roots = np.full(dim, 0.25), np.zeros_like(self.inside)
        roots[0, 0] = True
        x, closed = enclosing(mesh.vertices), np.zeros_like(self.inside)
        exact = [
            along_tree(mesh, closed, roots, pulls[n] + near[n], wrench_of_moments(x, moments[n], origin), origin)
            for n in range(len(near))
        ]
        return self._of(stacked(exact, axis=0), moments)

    def _of(self, pulls: Interval, moments: Interval) -> Interval:
        """The stresses with these tractions and moments, for each load."""
        count, cells = len(pulls.lo), len(self.mesh.vertices)
        repeated = self.cells.some(np.tile(np.arange(cells), count))
        stresses = stresses_of(repeated, *(each.reshape(-1, *each.lo.shape[2:]) for each in (pulls, moments)))
        return stresses.reshape(count, cells, *stresses.lo.shape[1:])

    def _floats(self, pulls: Interval, moments: Interval) -> tuple[Array, Array]:
        """Vectors whose squares are the energies of stresses, and forces and moments on all cells, per load."""
        dim, count, origin = self.dim, len(pulls.lo), np.full(self.dim, 0.25)
        y = self._of(pulls, moments)
        entries = self._mapped(y)
        size = dim + 1
        hats = np.linalg.cholesky((1 + np.eye(size)) / (size * (size + 1)))
        vectors = np.einsum("ncsve,vw->ncswe", middle(entries), hats)
        x = enclosing(self.mesh.vertices)
        on_facets = x[slice(None), opposite(dim)]
        wrench = total(wrenches(on_facets, pulls, origin), axis=2) + wrench_of_moments(x, moments, origin)
        scale = np.sqrt(self.cells.measure.hi[0] / size)
        return vectors.reshape(count, -1) * scale, middle(wrench).reshape(count, -1)

    def _mapped(self, y: Interval) -> Interval:
        """The entries of AyAᵀ, those off the diagonal times √2, shape (…, entries)."""
        dim, columns = self.dim, []
        for i in range(dim):
            for j in range(i, dim):
                factor = self.map[i, :, None] * self.map[j, None, :]
                value = total(total(y * factor))
                columns.append(value if i == j else value * root(enclosing(2.0)))
        return stacked(columns)

    def _energies(self, y: Interval) -> Interval:
        """(τ, τ') of all pairs."""
        size, entries = self.dim + 1, self._mapped(y)
        hats = (1 + np.eye(size)) / (size * (size + 1))
        columns = [total(entries * hats[v][:, None], axis=-2) for v in range(size)]
        weighted = stacked(columns, axis=-2) * (self.cells.measure / float(size))[:, None, None, None]
        count = len(entries.lo)
        return product(entries.reshape(count, -1), transposed(weighted.reshape(count, -1)))


def middle(a: Interval) -> Array:
    """The middles of intervals."""
    return (a.lo + a.hi) / 2


def transposed(a: Interval) -> Interval:
    """The transposed matrix."""
    return Interval(a.lo.T, a.hi.T)


def product(a: Interval, b: Interval) -> Interval:
    """The product of matrices, by middles and radii: a sum of n products in floats is wrong by n units of its terms."""
    (x, y), (r, s) = map(middle, (a, b)), ((each.hi - each.lo) * 0.500001 for each in (a, b))
    r, s = r + np.abs(x) * 1e-15, s + np.abs(y) * 1e-15
    length = (x.shape[1] + 4) * np.finfo(float).eps
    radius = (np.abs(x) @ s + r @ (np.abs(y) + s) + length * (np.abs(x) @ np.abs(y))) * (1 + 1e-9)
    return Interval(x @ y - radius * (1 + 1e-9), x @ y + radius * (1 + 1e-9))
