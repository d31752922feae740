"""The data of an elastic contact problem as the discrete problem sees them: values in points, moments on facets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import fem, la
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.elastic_problem import NORMAL, ElasticProblem, Plane
from signorini_fenicsx.discrete.elastic_spaces import BoundaryFacets, ElasticSpaces, linear_values
from signorini_fenicsx.discrete.johnson_mercier import SIMPLEX, SplitQuadrature
from signorini_fenicsx.discrete.sampling import Sample, Sampler, by_region
from signorini_fenicsx.meshes.domain import AXES

BLOCK = {2: 4096, 3: 512}
"""Cells, by dimension, whose values are held at a time: some tens of megabytes."""


@dataclass(frozen=True)
class Material:
    """E and ν in points of the cells.

    Attributes:
        young: E where each cell takes it from.
        poisson: ν likewise.
        young_of: For each cell which of them.
        poisson_of: Likewise.
        plane_stress: Whether θ is that of plane stress.
        dim: d.
    """

    young: list[Sampler]
    poisson: list[Sampler]
    young_of: Indices
    poisson_of: Indices
    plane_stress: bool
    dim: int

    @property
    def constant(self) -> bool:
        """Whether both are numbers."""
        return all(sampler.polynomial == 0 for sampler in [*self.young, *self.poisson])

    def sampled(self, points: Array) -> MaterialSample:
        """For values at these points of the reference cell (collective)."""
        return MaterialSample(
            [sampler.in_cells(points) for sampler in self.young],
            [sampler.in_cells(points) for sampler in self.poisson],
            self,
        )


@dataclass(frozen=True)
class MaterialSample:
    """E and ν at given points of the reference cell."""

    young: list[Sample]
    poisson: list[Sample]
    material: Material

    def given(self, cells: npt.NDArray[np.int32]) -> tuple[Array, Array]:
        """E and ν, shape (cells, points)."""
        material = self.material
        return _chosen(self.young, material.young_of, cells), _chosen(self.poisson, material.poisson_of, cells)

    def __call__(self, cells: npt.NDArray[np.int32]) -> tuple[Array, Array]:
        """1/2μ and θ, shape (cells, points)."""
        young, poisson = self.given(cells)
        in_space = self.material.plane_stress or self.material.dim == 3
        return (1 + poisson) / young, poisson / (1 + poisson) if in_space else poisson


def _chosen(samples: list[Sample], which: Indices, cells: npt.NDArray[np.int32]) -> Array:
    if len(samples) == 1:
        return samples[0](cells)
    found = None
    for index, sample in enumerate(samples):
        mine = which[cells] == index
        values = sample(cells[mine])
        found = np.empty((len(cells), values.shape[1])) if found is None else found
        found[mine] = values
    assert found is not None
    return found


@dataclass(frozen=True)
class ElasticData:
    """The data on a mesh.

    Attributes:
        f: Force.
        u_D: Displacement where it is given.
        g_N: Tractions, by the part where they are given; "" is everywhere.
        tractions: ∫ g_N φ_a over the facets of `spaces.neumann`, shape (facets, d, d).
        gap: g.
        exact: u, where it is known.
        material: E and ν.
        quadrature: What the discrete problem takes f, E and ν by.
        lift: û where it is given, g in the normal component on Γ_C, and 0 elsewhere: unknowns of this rank, ghosts too.
        load: ⟨g_N, q⟩ for each owned unknown.
        fixed: Owned unknowns that are given.
    """

    f: Sampler
    u_D: Sampler
    g_N: Mapping[str, Sampler]
    tractions: Array
    gap: Sampler
    exact: Sampler | None
    material: Material
    quadrature: SplitQuadrature
    lift: Array
    load: Array
    fixed: npt.NDArray[np.int32]

    @cached_property
    def loads(self) -> Sample:
        """The force at the points of the quadrature (collective at the first call)."""
        return self.f.in_cells(self.quadrature.points)

    @cached_property
    def moduli(self) -> MaterialSample:
        """1/2μ and θ there (collective at the first call)."""
        return self.material.sampled(self.quadrature.points)

    def moments_of_f(self, spaces: ElasticSpaces, cells: npt.NDArray[np.int32], measure: Array) -> Array:
        """(f, φ_v) for the hats of the vertices of cells with these |T|, shape (cells, d + 1, d)."""
        subcells, number, _ = self.quadrature.hats.shape
        values = self.loads(cells).reshape(len(cells), subcells, number, -1)
        sums = np.einsum("nsqr,sqv,q->nvr", values, self.quadrature.hats, self.quadrature.weights, optimize=True)
        return measure[:, None, None] / subcells * np.take_along_axis(sums, spaces.order[cells][:, :, None], axis=1)

    def masses(self, spaces: ElasticSpaces, cells: npt.NDArray[np.int32], measure: Array) -> tuple[Array, Array]:
        """∫ φ_a φ_b/2μ and ∫ θ φ_a φ_b/2μ over the subcells of cells with these |T|, see `compliance_product`."""
        inverse, theta = self.moduli(cells)
        local, weights = self.quadrature.local, self.quadrature.weights
        size = local.shape[1]
        products = np.einsum("q,qa,qb->qab", weights, local, local)
        cell, subcell, vertex = (place[..., None] for place in spaces.as_dolfinx(cells))
        order = cell, subcell, vertex, vertex.swapaxes(2, 3)
        of_all, of_traces = (
            measure[:, None, None, None] / size * np.tensordot(values, products, 1)[order]
            for values in (inverse.reshape(-1, size, len(weights)), (inverse * theta).reshape(-1, size, len(weights)))
        )
        return of_all, of_traces


def blocks_of_cells(spaces: ElasticSpaces) -> Iterator[npt.NDArray[np.int32]]:
    """The owned cells, so many at a time."""
    size, step = len(spaces.order), BLOCK[spaces.dim]
    for begin in range(0, size, step):
        yield np.arange(begin, min(begin + step, size), dtype=np.int32)


def elastic_data(spaces: ElasticSpaces, problem: ElasticProblem) -> ElasticData:
    """Read the data and check them (collective).

    Raises:
        InputError: If something is not finite where it is needed, E ≤ 0 or ν not between −1 and ½ somewhere, or a
            region has no value.
    """
    mesh, regions, dim = spaces.mesh, spaces.domain.regions, spaces.dim
    vectors = {name: Sampler(mesh, name, getattr(problem, name), vector=True) for name in ("f", "u_D")}
    gap = Sampler(mesh, "gap", problem.gap)
    young, young_of = by_region(mesh, "young", problem.young, regions)
    poisson, poisson_of = by_region(mesh, "poisson", problem.poisson, regions)
    material = Material(young, poisson, young_of, poisson_of, problem.plane == Plane.STRESS and dim == 2, dim)
    degree = max(2 if material.constant else 8, vectors["f"].degree + 1)
    quadrature = SplitQuadrature.of_degree(dim, min(degree, 30))
    lift = fem.Function(spaces.traces)
    load = la.vector(lift.function_space.dofmap.index_map, dim**2)
    fixed = _set_given(spaces, vectors["u_D"], gap, lift)
    given_by_part = problem.g_N if isinstance(problem.g_N, Mapping) else {"": problem.g_N}
    g_N = {part: Sampler(mesh, f"g_N.{part}".rstrip("."), each, vector=True) for part, each in given_by_part.items()}
    tractions = _traction_moments(spaces, g_N)
    _add_tractions(spaces, tractions, load)
    lift.x.scatter_forward()
    given = lift.x.array.astype(np.float64)
    exact = None if problem.exact is None else Sampler(mesh, "exact", problem.exact, vector=True)
    data = ElasticData(
        f=vectors["f"],
        u_D=vectors["u_D"],
        g_N=g_N,
        tractions=tractions,
        gap=gap,
        exact=exact,
        material=material,
        quadrature=quadrature,
        lift=given,
        load=load.array,
        fixed=fixed,
    )
    _check_cells(spaces, data)
    return data


def _check_cells(spaces: ElasticSpaces, data: ElasticData) -> None:
    """Make sure of f, E and ν in the points of the quadrature (collective)."""
    loads, moduli = data.loads, data.moduli
    finite, low, high, stiff = True, np.inf, -np.inf, np.inf
    for cells in blocks_of_cells(spaces):
        young, poisson = moduli.given(cells)
        finite = finite and bool(np.isfinite(loads(cells)).all())
        for values in (young, poisson):
            values[~np.isfinite(values)] = np.nan
        stiff = min(stiff, float(young.min()))
        low, high = min(low, float(poisson.min())), max(high, float(poisson.max()))
    comm = spaces.mesh.comm
    if not comm.allreduce(finite, MPI.LAND):
        raise InputError("[problem] f: not finite everywhere in the domain")
    ends = np.array([stiff, low, -high])
    comm.Allreduce(MPI.IN_PLACE, ends, MPI.MIN)
    stiff, low, high = ends[0], ends[1], -ends[2]
    if not (stiff > 0 and stiff < np.inf):
        raise InputError(f"[problem] young: must be positive and finite everywhere; its smallest value is {stiff:.3g}")
    if not (low > -1 and high < 0.5):
        wrong = low if not low > -1 else high
        raise InputError(f"[problem] poisson: must be between -1 and 1/2, without these; it is {wrong:.6g} somewhere")


def facet_rule(dim: int, degree: int) -> tuple[Array, Array]:
    """Points and weights of the reference facet, exact for hats times a polynomial of this degree."""
    points, weights = basix.make_quadrature(SIMPLEX[dim - 1], min(degree + 1, 30))
    return points, weights


def facet_moments(spaces: ElasticSpaces, sampler: Sampler, facets: BoundaryFacets, where: str) -> Array:
    """∫ value φ_a over facets (collective).

    Raises:
        InputError: If the values are not finite.
    """
    points, weights = facet_rule(spaces.dim, sampler.degree)
    values = sampler.on_facets(points)(facets.entities)
    if not spaces.mesh.comm.allreduce(bool(np.isfinite(values).all()), MPI.LAND):
        raise InputError(f"[problem] {sampler.name}: not finite everywhere {where}")
    return facets.moments(values, points, weights)


def _set_given(spaces: ElasticSpaces, u_D: Sampler, gap: Sampler, lift: fem.Function) -> npt.NDArray[np.int32]:
    """Write what û is where it is given, or g on Γ_C; returns the unknowns that are given (collective)."""
    unknowns = []
    for facets, k, letter in spaces.fixed:
        moments = facet_moments(spaces, u_D, facets, "where the displacement is given")
        values = linear_values(moments, facets.measure)
        along = np.einsum("nar,nr->na", values, facets.normals) if letter == NORMAL else values[..., AXES.index(letter)]
        places = spaces.unknowns(facets, k)
        lift.x.array[places] = along
        unknowns.append(places.ravel())
    moments = facet_moments(spaces, gap, spaces.contact, "on Γ_C")
    lift.x.array[spaces.sites] = moments.ravel() / spaces.site_measure
    return np.concatenate(unknowns)


def _traction_moments(spaces: ElasticSpaces, g_N: Mapping[str, Sampler]) -> Array:
    """∫ g_N φ_a over the facets of `spaces.neumann`; 0 on parts without one (collective).

    Raises:
        InputError: If σn is given on no such part.
    """
    facets = spaces.neumann
    moments = np.zeros((len(facets.facets), spaces.dim, spaces.dim))
    known = [*spaces.boundary.neumann, *spaces.boundary.fixed]
    for name, sampler in g_N.items():
        if name and name not in known:
            raise InputError(f"[problem] g_N: no traction is given on part '{name}', only on {', '.join(known)}")
        part = spaces.part(name) if name else facets
        here = np.searchsorted(facets.facets, part.facets)
        moments[here] = facet_moments(spaces, sampler, part, "where the traction is given")
    return moments


def _add_tractions(spaces: ElasticSpaces, moments: Array, load: la.Vector) -> None:
    """⟨g_N, q⟩ on Γ_N and on parts that are fixed in some components, each for its own unknowns."""
    by_block = load.array.reshape(-1, spaces.dim**2)
    by_block[spaces.neumann.blocks] = moments.reshape(-1, spaces.dim**2)
    for part, matrices in spaces.frames[1:]:
        by_block[part.blocks] = np.einsum("nij,ni->nj", matrices, by_block[part.blocks])
