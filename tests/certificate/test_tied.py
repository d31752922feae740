"""What v lacks where a pair is tied: its strain by another way, in space."""

import basix.ufl
import numpy as np
import pytest
from bodies_apart import two
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.api import Dirichlet, Elasticity, InputError, Neumann, Pair, Tied, solve
from signorini_fenicsx.discrete.linear_traces import opposite
from signorini_fenicsx.physics.elasticity.bound.tied import lacking, pulled_open, tied_pairs
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.quantities.kinds import Integral

STEP = 1e-5
STRESS = np.array([[1.0, 0.5, -2.0], [0.5, 3.0, 0.7], [-2.0, 0.7, 5.0]])


def opened(x: np.ndarray) -> np.ndarray:
    """A displacement of the lower body that is quadratic, and 0 at the corners of its top."""
    a, b = x[..., 0] * (1 - x[..., 0]), x[..., 1] * (1 - x[..., 1])
    return np.stack([a + 0.3 * b, b - 0.5 * a, a + 2 * b], axis=-1)


def mean_square(corners: np.ndarray, ends: int, seed: int) -> float:
    """The mean of |ε(d)|² over a subcell, d(x) = s opened(x_e) where s is the sum of the first hats, by differences."""
    to_hats = np.linalg.inv(np.vstack([corners.T, np.ones(4)]))

    def d(x: np.ndarray) -> np.ndarray:
        hats = np.concatenate([x, np.ones((*x.shape[:-1], 1))], axis=-1) @ to_hats.T
        s = hats[..., :ends].sum(axis=-1, keepdims=True)
        return s * opened(hats[..., :ends] / s @ corners[:ends])

    shares = np.random.default_rng(seed).dirichlet(np.ones(4), 40_000)
    x = shares @ corners
    slopes = np.stack([(d(x + STEP * e) - d(x - STEP * e)) / (2 * STEP) for e in np.eye(3)], axis=-1)
    return float((((slopes + slopes.swapaxes(1, 2)) / 2) ** 2).sum(axis=(1, 2)).mean())


def lift_of(held: str = "") -> tuple[ElasticSpaces, np.ndarray, float, float]:
    """Two cubes that are tied, where the lower one is opened.

    Returns:
        Their spaces, ‖ε(d)‖² on cells, the largest jump left, and ∫ yn·d for a constant y.
    """
    domain = two(MPI.COMM_SELF, (1, 1, 1), (2, 2, 1), gap=0.05)
    free = [f"{body}{axis}{end}" for body in "ul" for axis in (0, 1) for end in (0, 1)]
    fixed = [Dirichlet(part, 0) for part in ("u21", "l20", held) if part]
    loose = Neumann([part for part in free if part != held])
    solution = solve(domain, Elasticity(1.0, 0.3, conditions=[*fixed, loose, Pair("u20", "l21", Tied())]))
    spaces, split = solution.spaces, solution.spaces.split
    element = basix.ufl.element("P", split.mesh.basix_cell(), 2, basix.LagrangeVariant.bernstein, shape=(3,))
    v = fem.Function(fem.functionspace(split.mesh, element))
    v.interpolate(lambda x: np.where(x[2] < 0.02, opened(x.T).T, 0.0))
    pairs = list(tied_pairs(spaces, split, v.function_space))
    squares, past = lacking(pairs, spaces, solution.data, v)
    with pytest.raises(InputError, match="none is there over 'u10', which meets a tied slave"):
        solution.quantity(Integral(parts="u10", direction=(0, 0, 1)))
    stresses = np.tile(STRESS, (len(spaces.order), 4, 4, 1, 1))
    return spaces, squares[:, 0], past, pulled_open(pairs, spaces, stresses, v)


def test_strain_of_the_lift() -> None:
    """‖ε(d)‖ on each cell is that of d by differences at random points; on what is given nothing may be lacking."""
    spaces, found, past, pulled = lift_of()
    assert past < 1e-12
    assert pulled == pytest.approx(-STRESS[2] @ [1.3, 0.5, 3.0] / 6)
    expected = np.zeros(len(found))
    for cell, vertices in enumerate(spaces.vertices):
        for facet in vertices[opposite(3)]:
            low, total, middle = np.abs(facet[:, 2] - 0.05) < 1e-9, 0.0, vertices.mean(axis=0)
            if low.sum() > 1:  # the facet of a slave, or an edge of one
                total = mean_square(np.vstack([facet[low], facet[~low], middle]), low.sum(), cell)
            expected[cell] += total * spaces.cell_measures[cell] / 4
    np.testing.assert_allclose(found, expected, rtol=0.03, atol=1e-12)
    assert np.count_nonzero(found) == 4
    assert lift_of("u00")[2] > 0.1
