"""What quadrature may miss of the gap where E or ν vary within cells.

On deviators ℂ is 2μ and 𝔸 is 1/2μ, on multiples of I they are κ and 1/κ. On a subcell let each of these four be within
ρ of a quadratic polynomial. Let 𝔸_P have the polynomials for 1/2μ and 1/κ, and o = e − 𝔸y, o_P = e − 𝔸_P y for
e = ε(v). Then

    ‖o − o_P‖_ℂ ≤ s,   s² = sup 2μ ρ₃²‖dev y‖² + sup κ ρ₄²‖tr y‖²/d,

in true norms and in those by a quadrature with positive weights. o_P is cubic, so a quadrature that is exact for degree
8 has ‖o_P‖²_ℂ but for 2ρ₁‖dev o_P‖² + 2ρ₂‖tr o_P‖²/d ≤ 2η‖o_P‖²_ℂ, where η is the largest of ρ₁/inf 2μ and
ρ₂/inf κ. With ‖o‖_Q by quadrature

    ‖o‖_ℂ ≤ (‖o‖_Q + s)/√(1 − 2η) + s.

Where E and ν are numbers, and ε₀ or σ₀ within ρ of polynomials of degree 4 in their entries, η = 0, and s is the energy
of the rest: at most the root of |S| Σρ² times the largest eigenvalue of ℂ for ε₀, of 𝔸 for σ₀, both in space. There the
plane has less energy, as it is what is left after σ_zz or ε_zz is chosen.

`expressions.enclosures` has ρ where E and ν are texts, and from distances to constants how much a coefficient varies.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Self

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.certificate.certificate import Places, first_places
from signorini_fenicsx.discrete.linear_traces import blocks_of_cells
from signorini_fenicsx.expressions import TREES, values
from signorini_fenicsx.expressions.enclosures import distances
from signorini_fenicsx.expressions.tree import Binary, Call, Negative, Tree, exactly
from signorini_fenicsx.physics.elasticity.bound.body import why_no_constant
from signorini_fenicsx.physics.elasticity.bound.conforming import BestDisplacement
from signorini_fenicsx.physics.elasticity.discrete.data import LARGEST_DEGREE, ElasticData
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import split_vertices
from signorini_fenicsx.physics.elasticity.discrete.material import Material, Strain
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces

DEGREE = 2
"""Degree of the polynomials: e − 𝔸_P y is then cubic for v of a degree up to 4, see `certify.HIGHEST`."""
ENOUGH, ROUGHLY = 1e-9, 1e-2
"""A coefficient need not be known better than up to the first share of itself, how it varies than up to the second."""
RESOLVED = 0.05
"""A coefficient is not resolved if ρ is more than this share of it, or if it varies by more than half of itself."""
OWN = 4
"""Degree of the polynomials for strain and stress of the body's own: then their differences to ε(v) have this, too."""


def is_enclosed(material: Material) -> bool:
    """Whether a material is isotropic, with texts or numbers for E and ν, or μ, and without strain of its own."""
    one = len(material.young) == 1 and (material.incompressible or len(material.poisson) == 1)
    if not one or material.shear or material.axes or (material.strains and not material.incompressible):
        return False
    return all(datum.pieces is not None for datum in (*material.young, *material.poisson))


def is_own_enclosed(material: Material) -> bool:
    """Whether a material has numbers for its elastic constants, and texts or numbers for what it has of its own."""
    are_texts = [datum.pieces is not None for strain in material.strains for datum in (strain.datum, strain.beyond)]
    return material.uniform and all(are_texts)


def unresolved_by_quadrature(strain: Strain) -> bool:
    """Whether strain or stress of the body's own is no polynomial whose square quadrature integrates exactly."""
    degree = strain.datum.polynomial
    return degree is None or degree > LARGEST_DEGREE // 2


def _coefficients(material: Material, young: Tree, poisson: Tree | None) -> tuple[Tree, ...]:
    """2μ, κ, 1/2μ and 1/κ; of a fluid, whose law has no κ, 2μ and 0 in the place of κ and 1/κ."""
    one = exactly(1)
    if poisson is None:
        twice = Binary("*", exactly(2), young)
        return twice, twice, _inverse(twice), exactly(0)
    plus, less = Binary("+", one, poisson), Binary("-", one, Binary("*", exactly(2), poisson))
    if material.dim == 2:
        less = Binary("*", plus, less) if material.in_strain else Binary("-", one, poisson)
    inverse = _inverse(young)
    return Binary("/", young, plus), Binary("/", young, less), Binary("*", plus, inverse), Binary("*", less, inverse)


def _inverse(tree: Tree) -> Tree:
    """1 over a tree, so that products and exponential functions in it are enclosed as well as before."""
    match tree:
        case Call(name="exp", arguments=(exponent,)):
            return Call("exp", (Negative(exponent),))
        case Binary(sign="*", left=left, right=right):
            return Binary("*", _inverse(left), _inverse(right))
    return Binary("/", exactly(1), tree)


def _distances(
    spaces: ElasticSpaces,
    material: Material,
    cells: npt.NDArray[np.integer],
    vertices: Array,
    degree: int,
    share: float,
) -> tuple[Array, Array]:
    """ρ of the four coefficients on simplices, infinite where none is known, and their values in the middle.

    Args:
        spaces: The spaces.
        material: An enclosed material.
        cells: The owned cell in which each simplex is.
        vertices: Of the simplices, shape (simplices, d + 1, d).
        degree: Of the polynomials.
        share: Of the coefficients themselves; no better ρ is looked for below this.
    """
    rho, sizes = np.zeros((2, 4, len(cells)))
    middle = vertices.mean(axis=1)
    of_volume = ((None, None),) if material.incompressible else material.poisson[0].pieces or ()
    for young, with_young in material.young[0].pieces or ():
        for poisson, with_poisson in of_volume:
            masks = [mask[cells] for mask in (with_young, with_poisson) if mask is not None]
            chosen = np.flatnonzero(np.all(masks, axis=0)) if masks else np.arange(len(cells))
            assert isinstance(young, TREES)
            assert poisson is None or isinstance(poisson, TREES)
            for k, tree in enumerate(_coefficients(material, young, poisson)):
                sizes[k, chosen] = np.abs(np.broadcast_to(values(tree, middle), len(cells)))[chosen]
                rho[k, chosen] = distances(tree, vertices[chosen], spaces.frame, share * sizes[k, chosen], degree)
    return rho, sizes


@dataclass(frozen=True)
class _Stiffness:
    """What is known of the four coefficients on subcells, shape (4, subcells).

    Attributes:
        rho: ρ, infinite where none is known.
        least: Lower bounds.
        most: Upper bounds.
    """

    rho: Array
    least: Array
    most: Array

    @classmethod
    def of(cls, spaces: ElasticSpaces, material: Material) -> Self:
        """Enclose them on the subcells of all owned cells."""
        size = spaces.dim + 1
        cells = np.repeat(np.arange(len(spaces.order)), size)
        vertices = split_vertices(spaces.vertices).reshape(-1, size, spaces.dim)
        rho, middle = _distances(spaces, material, cells, vertices, DEGREE, ENOUGH)
        change, _ = _distances(spaces, material, cells, vertices, 0, ROUGHLY)
        return cls(rho, middle - 2 * change, middle + 2 * change)

    def on(self, subcells: Indices) -> "_Stiffness":
        """What is known on some of the subcells, given by their numbers."""
        return _Stiffness(self.rho[:, subcells], self.least[:, subcells], self.most[:, subcells])

    @property
    def resolved(self) -> npt.NDArray[np.bool_]:
        """Mask of the subcells where all coefficients are resolved."""
        return np.asarray(((self.rho <= RESOLVED * self.least) & (self.most <= 3 * self.least)).all(axis=0))


def is_varying(material: Material) -> bool:
    """Whether a material varies within cells and is enclosed."""
    return not material.uniform and is_enclosed(material)


@dataclass
class Resolution:
    """What encloses the data of one solution, and records where quadrature may miss too much of them.

    Attributes:
        spaces: The spaces.
        data: The data.
        coarse: Mask of the owned cells where data are not resolved.
        linear: Bound of the work that the Π₁d of `hidden` may do beside sup |w| per owned cell, once it is known.
    """

    spaces: ElasticSpaces
    data: ElasticData
    coarse: npt.NDArray[np.bool_] = field(init=False)
    linear: Array = field(init=False)
    _noted: list[tuple[str, tuple[float, ...]]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.coarse, self.linear = np.zeros(len(self.spaces.order), dtype=bool), np.zeros(len(self.spaces.order))
        if self._stiffness is not None:
            varies = np.zeros(len(self.coarse), dtype=bool)
            varies[np.flatnonzero(~self._stiffness.resolved) // (self.spaces.dim + 1)] = True
            self.note(" or ".join(self.data.material.words), varies)

    @cached_property
    def _stiffness(self) -> _Stiffness | None:
        """What is known of E and ν; None if they are numbers or are not enclosed."""
        material = self.data.material
        return _Stiffness.of(self.spaces, material) if is_varying(material) else None

    @cached_property
    def _own(self) -> Array | None:
        """S of strain and stress of the body's own on the subcells; None if quadrature is exact (collective).

        Where it is large beside the largest value it is 0, and recorded that these are not resolved.
        """
        spaces, material = self.spaces, self.data.material
        if not is_own_enclosed(material) or not any(map(unresolved_by_quadrature, material.strains)):
            return None
        size, squares = spaces.dim + 1, np.zeros(len(spaces.order) * (spaces.dim + 1))
        for strain in material.strains:
            rho, largest = _of_strain(spaces, strain)
            largest = spaces.mesh.comm.allreduce(float(largest.max(initial=0.0)), MPI.MAX)
            coarse = ~(rho <= RESOLVED * largest)
            self.note(strain.name, coarse.reshape(-1, size).any(axis=1))
            squares += np.where(coarse, 0.0, rho) * np.repeat(self._energy_of(strain.name), size)
        return squares * np.sqrt(np.repeat(spaces.cell_measures, size) / size)

    def _energy_of(self, name: str) -> Array:
        """The root of the largest eigenvalue of ℂ or 𝔸 in space on the owned cells (collective)."""
        energy = np.empty(len(self.coarse))
        for cells in blocks_of_cells(self.spaces.mesh):
            softness = self.data.material.softness_in_space(self.data.points(self.spaces, cells).first)[:, 0]
            energy[cells] = softness[:, -1] if name == "initial_stress" else 1 / softness[:, 0]
        return np.sqrt(energy)

    @cached_property
    def no_constant(self) -> str:
        """Why there is no constant of the body, which encloses loads; empty if there is (collective at first)."""
        return why_no_constant(self.spaces)

    def note(self, name: str, cells: npt.NDArray[np.bool_]) -> None:
        """Record a mask of the owned cells where a datum is not resolved."""
        self.coarse |= cells
        self._noted += [(name, tuple(x)) for x in self.spaces.vertices[cells].mean(axis=1).tolist()]

    def unresolved(self) -> Places:
        """The data that are not resolved, each with a place, the same on all ranks (collective)."""
        return first_places(self._noted, self.spaces.mesh.comm)

    def stiffest(self) -> Array:
        """The largest eigenvalue of ℂ on each owned cell; in points where E and ν are not enclosed (collective)."""
        if self._stiffness is not None:
            return np.asarray(self._stiffness.most[:2].max(axis=0).reshape(len(self.coarse), -1).max(axis=1))
        largest = np.zeros(len(self.coarse))
        for cells in blocks_of_cells(self.spaces.mesh):
            eigenvalues = np.linalg.eigvalsh(self.data.compliances(self.spaces, cells))
            stiff = -1 if self.data.material.incompressible else 0  # of a fluid on deviators
            largest[cells] = 1 / eigenvalues[..., stiff].min(axis=1)
        return largest

    def with_missed(self, problem: BestDisplacement, squares: Array) -> Array:
        """‖o‖²_ℂ at most, from ‖o‖²_Q, per subcell of the split mesh or the part of it (collective).

        It is ‖o‖²_Q itself where all is a polynomial or not enclosed, and where a coefficient is not resolved.
        """
        if self._own is not None:
            return np.asarray((np.sqrt(np.maximum(squares, 0.0)) + 2 * self._own[problem.split.subcells]) ** 2)
        if self._stiffness is None:
            return squares
        split, y = problem.split, problem.sigma
        stiffness = self._stiffness.on(split.subcells)
        weight = ufl.TestFunction(fenicsx.function_space(split.mesh, ("DG", 0)))
        forms = (
            weight * form * ufl.dx for form in (ufl.inner(ufl.dev(y), ufl.dev(y)), ufl.tr(y) ** 2 / problem.spaces.dim)
        )
        sizes = np.stack([fem.assemble_vector(fenicsx.form(form)).array[: len(squares)] for form in forms])
        resolved = stiffness.resolved
        rho, least, most = (np.where(resolved, each, 1.0) for each in (stiffness.rho, stiffness.least, stiffness.most))
        s = np.sqrt((most[:2] * rho[2:] ** 2 * sizes).sum(axis=0))
        eta = (rho[:2] / least[:2]).max(axis=0)
        root = (np.sqrt(np.maximum(squares, 0.0)) + s) / np.sqrt(np.where(resolved, 1 - 2 * eta, 1.0)) + s
        return np.where(resolved, root**2, squares)


def _of_strain(spaces: ElasticSpaces, strain: Strain) -> tuple[Array, Array]:
    """The root of Σρ² over the entries on the subcells, infinite where none is known, and the largest entries."""
    size, dim = spaces.dim + 1, spaces.dim
    cells, vertices = np.repeat(np.arange(len(spaces.order)), size), split_vertices(spaces.vertices)
    vertices = vertices.reshape(-1, size, dim)
    middle = vertices.mean(axis=1)
    squares, largest = np.zeros((2, len(cells)))
    for datum, times in ((strain.datum, dim), (strain.beyond, 3 - dim)):
        for given, rows in datum.pieces_in(cells):
            entries = [(given, times)] if isinstance(given, TREES) else [(each, 1) for row in given for each in row]
            for tree, count in entries:
                value = np.abs(np.broadcast_to(values(tree, middle), len(cells)))[rows]
                rho = distances(tree, vertices[rows], spaces.frame, ENOUGH * value, OWN)
                squares[rows] += count * rho**2
                largest[rows] = np.maximum(largest[rows], value)
    return np.sqrt(squares), largest


def beyond(spaces: ElasticSpaces, data: ElasticData, cells: npt.NDArray[np.int32]) -> Array:
    """How much larger 𝔸 may be on cells than in any point of each, a factor of the unit matrix, shape (cells,)."""
    if not is_varying(data.material):
        return np.zeros(len(cells))
    change, _ = _distances(spaces, data.material, cells, spaces.vertices[cells], 0, ROUGHLY)
    larger = 2 * change[2:].max(axis=0)
    return np.where(np.isfinite(larger), larger, 0.0)
