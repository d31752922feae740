"""What quadrature may miss of the gap where E or ν vary within cells.

Twice the gap has (ℂe, e) − 2(e, y) + (𝔸y, y) with e = ε(v), where ℂe = 2μe + λ tr e I and 𝔸y = (y − θ tr y I)/2μ. On a
subcell let one of these coefficients, c, be within ρ of a polynomial of degree K, and let a quadrature with positive
weights be exact for that polynomial times q ≥ 0. It has ∫ cq but for 2ρ ∫ q. So twice the gap is at most what
quadrature gives and

    2 (ρ₁‖e‖² + ρ₂‖tr e‖² + ρ₃‖y‖² + ρ₄‖tr y‖²)   for c = 2μ, λ, 1/2μ and θ/2μ.

`expressions.enclosures` has ρ where E and ν are texts. A largest 𝔸 on a cell is one in a point with 2(ρ₃ + dρ₄)I, ρ the
distances to constants.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.certificate.certificate import Places, first_places
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.expressions import TREES, values
from signorini_fenicsx.expressions.enclosures import distances
from signorini_fenicsx.expressions.series import DEGREE
from signorini_fenicsx.expressions.tree import Binary, Call, Negative, Tree, exactly
from signorini_fenicsx.forms.elasticity import strain
from signorini_fenicsx.physics.elasticity.bound.conforming import BestDisplacement
from signorini_fenicsx.physics.elasticity.data import ElasticData
from signorini_fenicsx.physics.elasticity.material import Material
from signorini_fenicsx.physics.elasticity.problem import Plane
from signorini_fenicsx.physics.elasticity.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.split_mesh import SplitMesh

ENOUGH, RESOLVED, ROUGHLY = 1e-9, 1e-2, 1e-2
"""In the gap a coefficient need not be known better than up to the first share of itself. It is not resolved if ρ is
more than the second share of 2μ or 1/2μ. Beside an 𝔸 in a point it need not be known better than up to the third one.
"""
NAME = "young and poisson"


def is_enclosed(material: Material) -> bool:
    """Whether a material is isotropic, with texts or numbers for E and ν, and has no strain or stress of its own."""
    if len(material.young) != 1 or len(material.poisson) != 1 or material.shear or material.axes or material.own:
        return False
    return all(datum.pieces is not None for datum in (*material.young, *material.poisson))


def _coefficients(material: Material, young: Tree, poisson: Tree) -> tuple[Tree, ...]:
    """2μ, λ, 1/2μ and θ/2μ; in plane stress λ is that in the plane."""
    one = exactly(1)
    more, less = Binary("+", one, poisson), Binary("-", one, Binary("*", exactly(2), poisson))
    if material.dim == 2 and material.plane == Plane.STRESS:
        less = Binary("-", one, poisson)
    shear, softness = Binary("/", young, more), Binary("*", more, _inverse(young))
    of_trace = Binary("*", poisson, softness if material.in_strain else _inverse(young))
    return shear, Binary("*", shear, Binary("/", poisson, less)), softness, of_trace


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
    """ρ of the four coefficients on simplices, infinite where none is known, and their sizes, (4, simplices) each.

    Args:
        spaces: The spaces.
        material: An enclosed material.
        cells: The owned cell in which each simplex is.
        vertices: Of the simplices, shape (simplices, d + 1, d).
        degree: Of the polynomials.
        share: Of the coefficients themselves; no better ρ is looked for below this.
    """
    rho, sizes = np.zeros((2, 4, len(cells)))
    middle = dict(zip("xyz", np.moveaxis(vertices.mean(axis=1), -1, 0), strict=False))
    for young, with_young in material.young[0].pieces or ():
        for poisson, with_poisson in material.poisson[0].pieces or ():
            masks = [mask[cells] for mask in (with_young, with_poisson) if mask is not None]
            here = np.flatnonzero(np.all(masks, axis=0)) if masks else np.arange(len(cells))
            assert isinstance(young, TREES)
            assert isinstance(poisson, TREES)
            for k, tree in enumerate(_coefficients(material, young, poisson)):
                sizes[k, here] = np.abs(np.broadcast_to(values(tree, middle), len(cells)))[here]
                rho[k, here] = distances(tree, vertices[here], spaces.frame, share * sizes[k, here], degree)
    return rho, sizes


def _unsure(spaces: ElasticSpaces, material: Material, split: SplitMesh) -> tuple[Array, npt.NDArray[np.bool_]]:
    """ρ of the four coefficients on the subcells of a split mesh, and the mask of those where all are resolved."""
    cells, vertices = split.subcells // (spaces.dim + 1), corners(split.mesh)
    rho, sizes = _distances(spaces, material, cells, vertices, DEGREE, ENOUGH)
    return rho, (rho <= RESOLVED * sizes[[0, 0, 2, 2]]).all(axis=0)


def missed(problem: BestDisplacement, v: fem.Function) -> Expr | None:
    """What is added to twice the gap, per volume, for a displacement v on the split mesh or a part of it (collective).

    None where nothing is: E and ν are numbers on each region, or are not enclosed. It is 0 on subcells where a
    coefficient is not resolved, which `unresolved` tells: there the bound relies on quadrature.
    """
    material, split = problem.data.material, problem.split
    if material.uniform or not is_enclosed(material):
        return None
    rho, resolved = _unsure(problem.spaces, material, split)
    unsure = fem.Function(fenicsx.function_space(split.mesh, ("DG", 0, (4,))))
    of_cells = unsure.x.array.reshape(-1, 4)
    of_cells[unsure.function_space.dofmap.list[: len(resolved), 0]] = np.where(resolved, rho, 0.0).T
    e, y = strain(v), problem.sigma
    sizes = ufl.inner(e, e), ufl.tr(e) ** 2, ufl.inner(y, y), ufl.tr(y) ** 2
    return 2 * ufl.dot(unsure, ufl.as_vector(sizes))


def unresolved(spaces: ElasticSpaces, data: ElasticData) -> tuple[Places, npt.NDArray[np.bool_]]:
    """Where E or ν are enclosed but not resolved: places, the same on all ranks, and the owned cells (collective)."""
    coarse = np.zeros(len(spaces.order), dtype=bool)
    if not data.material.uniform and is_enclosed(data.material):
        _, resolved = _unsure(spaces, data.material, spaces.split)
        coarse[spaces.split.subcells[~resolved] // (spaces.dim + 1)] = True
    places = [("young or poisson", tuple(x)) for x in spaces.vertices[coarse].mean(axis=1).tolist()]
    return first_places(places, spaces.mesh.comm), coarse


def beyond(spaces: ElasticSpaces, data: ElasticData, cells: npt.NDArray[np.int32]) -> Array:
    """How much larger 𝔸 may be on cells than in any point of each, a factor of the unit matrix, shape (cells,)."""
    if data.material.uniform or not is_enclosed(data.material):
        return np.zeros(len(cells))
    (*_, softness, of_trace), _ = _distances(spaces, data.material, cells, spaces.vertices[cells], 0, ROUGHLY)
    found = 2 * (softness + spaces.dim * of_trace)
    return np.where(np.isfinite(found), found, 0.0)
