"""What is given on facets: moments of data against the hats of the vertices, and tractions with their loads.

*Gaps that differ by linear functions on facets*: of tools that move, and of tools that are surface meshes.

The distance to a surface mesh along the normal of a facet of Γ_C is taken at the vertices of the facet, and is linear
between them. So the gap is as the mesh of the body sees the tool: the tool itself where it is plane over each facet.
The discrete problem has exactly this gap, and the bound is one of the distance to the solution with it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import la
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask, positions
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.discrete.data_values import check_means
from signorini_fenicsx.discrete.datum import DEGREES, Datum, datum_of
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, linear_values
from signorini_fenicsx.discrete.points import FacetPoints, Points, in_facets
from signorini_fenicsx.discrete.vectors import PressureDatum, VectorDatum, vector_datum_of
from signorini_fenicsx.expressions.given import Given, parsed
from signorini_fenicsx.meshes.domain import other_side
from signorini_fenicsx.meshes.surfaces import read_surface
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.problem import ElasticProblem, GivenVector


@dataclass(frozen=True)
class RaisedGap(Datum):
    """A gap that is larger by a linear function on each of some facets of Γ_C.

    Attributes:
        gap: The gap without it.
        facets: The facets, ascending.
        offsets: The function at the origin, for each facet.
        slopes: Its gradient along each of them, shape (facets, d).
    """

    gap: Datum
    facets: npt.NDArray[np.int32]
    offsets: Array
    slopes: Array
    number = None

    @classmethod
    def of(cls, gap: Datum, facets: BoundaryFacets, by: Array) -> "RaisedGap":
        """A gap raised by a function with these values at the vertices of facets, shape (facets, d)."""
        edges = facets.vertices[:, 1:] - facets.vertices[:, :1]
        slopes = np.einsum("nik,nk->ni", np.linalg.pinv(edges), by[:, 1:] - by[:, :1])
        offsets = by[:, 0] - np.einsum("ni,ni->n", slopes, facets.vertices[:, 0])
        order = np.argsort(facets.facets)
        return cls(gap.ufl, gap, facets.facets[order], offsets[order], slopes[order])

    @property
    def degree(self) -> int:
        """The degree that is estimated."""
        return max(self.gap.degree, 1)

    @property
    def polynomial(self) -> int | None:
        """The degree of the polynomial that it is on each facet, or None."""
        return None if self.gap.polynomial is None else max(self.gap.polynomial, 1)

    def by_facets(self, facets: npt.NDArray[np.int32]) -> list[tuple[Mask, Datum]]:
        """The data of the gap on facets; the function that raises it is none of the data."""
        return self.gap.by_facets(facets)

    def _look(self, points: Points, *, slope: bool) -> Array:
        assert isinstance(points, FacetPoints)
        assert not slope
        gaps = np.array(self.gap.values(points))
        on = np.flatnonzero(np.isin(points.facets, self.facets))
        rows = np.searchsorted(self.facets, points.facets[on])
        gaps[on] += self.offsets[rows, None] + np.einsum("nqi,ni->nq", points.x[on], self.slopes[rows])
        return gaps


def beyond_surfaces(spaces: ElasticSpaces, gap: Datum, surfaces: Mapping[str, str | Path]) -> Datum:
    """A gap that is that to surfaces from files, by part, and the given one more (collective).

    A vertex from which the normal misses the surface is as far from it as the domain is long.

    Raises:
        InputError: If a file cannot be used, or is nowhere in reach.
    """
    comm = spaces.mesh.comm
    for part, path in surfaces.items():
        if part not in spaces.boundary.contact or other_side(part) in spaces.domain.parts:
            raise InputError(f"[[law]] surface: part '{part}' is not in contact with a foundation")
        facets, key = spaces.part(part), (part, str(path))
        if key not in spaces.distances:
            surface = read_surface(comm, path, spaces.dim)
            directions = np.repeat(facets.normals, spaces.dim, axis=0)
            spaces.distances[key] = surface.distances(facets.vertices.reshape(-1, spaces.dim), directions)
        distances = spaces.distances[key].reshape(-1, spaces.dim)
        if not comm.allreduce(bool(np.isfinite(distances).any()), MPI.LOR):
            raise InputError(f"surface {path}: no line along the normal from a vertex of part '{part}' meets it")
        far = float(np.ptp(spaces.domain.box()[:, : spaces.dim], axis=0).max())
        gap = RaisedGap.of(gap, facets, np.where(np.isfinite(distances), distances, far))
    return gap


DEGREE, LARGEST_DEGREE = DEGREES


@dataclass(frozen=True)
class Pull:
    """A traction on a part of Γ_N or Γ_C besides those of the problem, or of its foundation.

    Attributes:
        facets: The facets of the part.
        datum: The traction.
        moments: ∫ value φ_a, shape (facets, d, d).
    """

    facets: BoundaryFacets
    datum: VectorDatum | PressureDatum
    moments: Array


def facet_rule(dim: int, degree: int) -> tuple[Array, Array]:
    """Points and weights of the reference facet, exact for hats times a polynomial of this degree."""
    points, weights = basix.make_quadrature(SIMPLEX[dim - 1], min(degree + 1, LARGEST_DEGREE))
    return points, weights


def facet_moments(
    spaces: ElasticSpaces, name: str, datum: Datum | VectorDatum | PressureDatum, facets: BoundaryFacets, where: str
) -> Array:
    """∫ value φ_a over facets (collective).

    Raises:
        InputError: If the values are not finite, or of no usable size.
    """
    degree = DEGREE if datum.polynomial is None else datum.polynomial
    points = in_facets(spaces.mesh, facets.facets, *facet_rule(spaces.dim, degree))
    values = datum.values(points)
    check_means(name, where, values, spaces)
    return facets.moments(values, points.points, points.weights)


def tractions_given(spaces: ElasticSpaces, problem: ElasticProblem) -> dict[str, VectorDatum | PressureDatum]:
    """The tractions and pressures by part (collective).

    Raises:
        InputError: If a text cannot be read, a part is unknown, or it has both.
    """
    by_part = problem.g_N if isinstance(problem.g_N, Mapping) else {"": problem.g_N} if problem.g_N is not None else {}
    tractions: dict[str, VectorDatum | PressureDatum] = {
        part: vector_datum_of(spaces, f"g_N.{part}".rstrip("."), each) for part, each in by_part.items()
    }
    for part, given in problem.pressure.items():
        name = f"pressure.{part}"
        if part in tractions or "" in tractions:
            raise InputError(f"[problem] {name}: a traction g_N is given there, too; give one of them, by part")
        _check_loaded(spaces, "pressure", part)
        datum = datum_of(spaces, name, parsed(given, "xyz"[: spaces.dim], f"[problem] {name}"))
        tractions[part] = PressureDatum(name, datum, spaces.part(part).normals)
    return tractions


def _check_loaded(spaces: ElasticSpaces, key: str, part: str) -> None:
    """Refuse a load on a part that is not in Γ_N.

    Raises:
        InputError: If it is not.
    """
    loaded = [*spaces.boundary.neumann, *spaces.boundary.fixed]
    if part not in loaded:
        where = f"{', '.join(loaded)} are" if loaded else "no part is"
        raise InputError(f"[problem] {key}: part '{part}' takes no traction, as it is not in neumann or fixed; {where}")


def traction_moments(spaces: ElasticSpaces, g_N: Mapping[str, VectorDatum | PressureDatum]) -> Array:
    """∫ g_N φ_a over the facets of `spaces.neumann`; 0 on parts without one (collective).

    Raises:
        InputError: If σn is given on no such part.
    """
    facets = spaces.neumann
    moments = np.zeros((len(facets.facets), spaces.dim, spaces.dim))
    for name, datum in g_N.items():
        if name:
            _check_loaded(spaces, "g_N", name)
        part = spaces.part(name) if name else facets
        rows = np.searchsorted(facets.facets, part.facets)
        moments[rows] = facet_moments(spaces, datum.name, datum, part, "where the traction is given")
    return moments


def add_tractions(spaces: ElasticSpaces, moments: Array, pulled: Array, load: la.Vector) -> None:
    """⟨g_N, q⟩ on Γ_N, on parts that are fixed in some components, and on Γ_C, each for its own unknowns."""
    size, contact = spaces.dim**2, spaces.contact
    by_block = load.array.reshape(-1, size)
    by_block[spaces.neumann.blocks] = moments.reshape(-1, size)
    by_block[contact.blocks] = contact.of_linear(pulled).reshape(-1, size)
    (contact, matrices), _, *fixed = spaces.frames
    by_block[contact.blocks] = np.einsum("nij,ni->nj", matrices, by_block[contact.blocks])
    for part, matrices in fixed:
        by_block[part.blocks] = np.einsum("nij,ni->nj", matrices, by_block[part.blocks])


def pulls_of(spaces: ElasticSpaces, given: Mapping[str, GivenVector | Given]) -> tuple[Pull, ...]:
    """Tractions on parts, or pressures where a scalar is given (collective).

    Raises:
        InputError: If a text cannot be read.
    """
    pulls = []
    for name, each in given.items():
        facets, key = spaces.part(name), f"traction.{name}"
        datum: VectorDatum | PressureDatum
        if isinstance(each, Sequence) and not isinstance(each, str):
            datum = vector_datum_of(spaces, key, each)
        else:
            pressure = datum_of(spaces, key, parsed(each, "xyz"[: spaces.dim], key))
            datum = PressureDatum(key, pressure, facets.normals)
        pulls.append(Pull(facets, datum, facet_moments(spaces, key, datum, facets, f"on the part '{name}'")))
    return tuple(pulls)


def add_pulls(spaces: ElasticSpaces, pulls: Sequence[Pull], tractions: Array) -> Array:
    """Add tractions on Γ_N to the moments there; those on Γ_C are returned by their values at the vertices.

    Where two bodies touch they are those on the named side, and pull at the other side the other way.

    Args:
        spaces: The spaces.
        pulls: The tractions.
        tractions: Moments on the facets of `spaces.neumann`, which are changed.
    """
    on_contact = np.zeros((len(spaces.contact.facets), spaces.dim, spaces.dim))
    for pull in pulls:
        for facets, moments in ((spaces.neumann, tractions), (spaces.contact, on_contact)):
            common = np.isin(pull.facets.facets, facets.facets)
            moments[positions(facets.facets, pull.facets.facets[common])] += pull.moments[common]
    return linear_values(on_contact, spaces.contact.measure)


def neighbours(spaces: ElasticSpaces) -> tuple[Indices, Indices]:
    """The sites near each site, those of its kind and facet, itself once; and the normal sites of its facet."""
    dim, (normal, slip) = spaces.dim, spaces.site_kinds
    number = np.arange(len(spaces.site_kinds))
    along = dim * (dim - 1)
    near, pressing = np.full((len(number), max(dim, along)), -1), np.tile(number[:, None], (1, dim))
    normal.of(near)[:, :dim] = np.repeat(normal.rows_of(number), dim, axis=0)
    slip.of(near)[:, :along] = np.repeat(slip.of(number).reshape(-1, along), along, axis=0)
    slip.of(pressing)[:] = np.repeat(slip.pressing, along, axis=0)
    return near, pressing
