"""Enclosures are true in all points, find what quadrature misses, and are sharp for smooth data."""

import math
import random
from itertools import permutations

import numpy as np
import pytest
from fuzzing.texts import grammatical
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.reference_cells import EDGES
from signorini_fenicsx.expressions import read, values, values_and_gradient
from signorini_fenicsx.expressions.cutting import Frame
from signorini_fenicsx.expressions.enclosures import distances, means, surely_above
from signorini_fenicsx.expressions.intervals import FromNumPy
from signorini_fenicsx.expressions.simplices import Quadratic, constant, interpolated, quadratic
from signorini_fenicsx.rigorous.enclosures import enclose

NUMPY = FromNumPy()


def squares(n: int) -> np.ndarray:
    """The structured mesh of the unit square, shape (2n², 3, 2)."""
    corner = np.stack(np.meshgrid(np.arange(n), np.arange(n), indexing="ij"), axis=-1).reshape(-1, 1, 2)
    lower, upper = np.array([[0, 0], [1, 0], [1, 1]]), np.array([[0, 0], [1, 1], [0, 1]])
    return np.concatenate([corner + lower, corner + upper]) / n


def inside(vertices: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random points of each simplex, shape (count, n, d)."""
    weights = rng.dirichlet(np.full(vertices.shape[1], 0.7), (count, len(vertices)))
    return np.einsum("cnv,nvi->cni", weights, vertices)


def value_of(p: Quadratic, vertices: np.ndarray, points: np.ndarray) -> np.ndarray:
    offset = points - vertices.mean(axis=1)
    bend = np.einsum("nij,cnj->cni", p.hessian, offset)
    return p.value + ((p.gradient + bend / 2) * offset).sum(axis=2)


def test_values_above_a_bound():
    """Data that are above 0 by far are so in all cells, at the first look; else only cells where they are."""
    frame, vertices = Frame(np.array([[0.0, 0.0], [1.0, 1.0]]), 800, MPI.COMM_SELF), squares(20)
    for text in ("1 + 0.8*x - 0.2*y", "2 + sin(9*x*y)", "exp(-x)/(1 + y^2)"):
        assert surely_above(read(text, "xy"), vertices, frame, np.zeros(800)).all()
    above = surely_above(read("x - 0.52", "xy"), vertices, frame, np.zeros(800))
    assert (above == (vertices[:, :, 0].min(axis=1) > 0.52)).all()
    hidden = read("1 - 1.001*exp(-1e6*((x - 0.31)^2 + (y - 0.37)^2))", "xy")
    missed = vertices[~surely_above(hidden, vertices, frame, np.zeros(800))]
    assert 0 < len(missed) < 20
    assert ((missed.min(axis=1) < [0.31, 0.37]) & (missed.max(axis=1) > [0.31, 0.37])).all(axis=1).any()


@pytest.mark.parametrize("corners", [2, 3, 4])
@pytest.mark.parametrize("dim", [2, 3])
def test_enclosures_hold(dim: int, corners: int):
    """Sampled values and slopes of random expressions on random simplices are inside the enclosures."""
    if corners > dim + 1:
        return
    known = 0
    names = "xyz"[:dim]
    for seed in range(10):
        rng = np.random.default_rng(seed)
        try:
            tree = read(grammatical(random.Random(seed), int(rng.integers(2, 8))), names)
        except InputError:
            continue
        sizes = 10.0 ** rng.uniform(-3, 0.5, (12, 1, 1))
        vertices = rng.uniform(-1, 1, (12, 1, dim)) + sizes * rng.uniform(-1, 1, (12, corners, dim))
        p = interpolated(tree, vertices)
        p = p if np.isfinite(p.value).all() else constant(np.zeros(12), dim)
        found = enclose(tree, vertices, p, np.full(12, 1e-2), NUMPY)
        points = inside(vertices, 400, rng)
        e, gradient = values_and_gradient(tree, points)
        d = e - value_of(p, vertices, points)
        bend = np.einsum("nij,cnj->cni", p.hessian, points - vertices.mean(axis=1))
        slope = np.linalg.norm(gradient - p.gradient - bend, axis=2)
        noise = 1e-12 * (1 + np.abs(p.value))
        assert not (e < found.range.lo).any()
        assert not (e > found.range.hi).any()
        assert not (np.abs(d) > found.largest + noise).any()
        assert not (slope > found.slope * (1 + 1e-9) + noise / sizes[:, 0, 0]).any()
        assert not (found.norm > found.largest * (1 + 1e-9) + noise).any()
        known += np.isfinite(found.norm).sum()
    assert known > 50


def test_means_and_norms():
    """Against sums over many points, for p of degree 0, 1 and 2."""
    vertices = squares(2)
    n = 200
    i, j = (index.ravel() for index in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    first, second = (i + 1 / 3) / n, (j + 1 / 3) / n
    fold = first + second > 1
    a, b = np.where(fold, 1 - first, first), np.where(fold, 1 - second, second)
    for text in ("sin(3*x)*exp(y)", "1 if (x - 0.4)^2 + (y - 0.3)^2 < 0.04 else 0", "abs(x - 0.3)*y"):
        tree = read(text, "xy")
        full = interpolated(tree, vertices)
        parts = [full, Quadratic(full.value, full.gradient, 0 * full.hessian), constant(full.value, 2)]
        for p in parts:
            found = enclose(tree, vertices, p, np.full(8, 1e-4), NUMPY)
            for cell, (o, v, w) in enumerate(vertices):
                points = o + a[:, None] * (v - o) + b[:, None] * (w - o)
                one = Quadratic(p.value[[cell]], p.gradient[[cell]], p.hessian[[cell]])
                d = values(tree, points)
                d = d - value_of(one, vertices[[cell]], points[:, None])[:, 0]
                mean, norm = d.mean(), np.sqrt((d**2).mean())
                assert found.mean.lo[cell] - 1e-3 <= mean <= found.mean.hi[cell] + 1e-3
                assert 0.999 * norm - 1e-3 <= found.norm[cell] <= 1.45 * norm + 1e-2


def test_what_quadrature_does_not_see():
    """A disc, a peak and a wave on a coarse mesh; for a wave there is a bound, too."""
    vertices = squares(5)
    area = 0.02
    zero = constant(np.zeros(50), 2)
    for text, norm, integral in [
        ("1e4 if (x-0.515)^2+(y-0.54)^2 < 2.5e-5 else 0", 1e4 * np.sqrt(np.pi * 2.5e-5), 1e4 * np.pi * 2.5e-5),
        ("1e5*exp(-2e5*((x-.515)^2+(y-.54)^2))", 1e5 * np.sqrt(np.pi / 4e5), 1e5 * np.pi / 2e5),
    ]:
        found = enclose(read(text, "xy"), vertices, zero, np.full(50, 1e-2), NUMPY)
        total = np.sqrt(area * (found.norm**2).sum())
        assert norm <= total <= 1.42 * norm
        assert area * found.mean.lo.sum() <= integral <= area * found.mean.hi.sum()
        np.testing.assert_allclose(found.place[found.norm.argmax()], [0.515, 0.54], atol=0.01)
    wave = read("3000*sin(40*pi*x)*sin(40*pi*y)", "xy")
    found = enclose(wave, vertices, interpolated(wave, vertices), np.full(50, 1.0), NUMPY)
    assert np.isfinite(found.norm).all()
    hole = read("sqrt((x - 0.515)^2 + (y - 0.54)^2 - 1e-5)", "xy")
    found = enclose(hole, vertices, zero, np.full(50, 1e-2), NUMPY)
    assert np.isinf(found.norm).sum() == 1


def test_smooth_data_are_cheap():
    """Remainders are of third order; quadratics are exact."""
    tree = read("40*(x-0.6) + sin(5*x)*exp(y)", "xy")
    norms = []
    for n in (8, 16):
        vertices = squares(n)
        found = enclose(tree, vertices, interpolated(tree, vertices), np.full(len(vertices), 0.1), NUMPY)
        norms.append(np.sqrt((found.norm**2).mean()))
    assert norms[1] < norms[0] / 6
    vertices = squares(10)
    tree = read("50*(1/2 - x)*(1/2 - y)", "xy")
    found = enclose(tree, vertices, interpolated(tree, vertices), np.full(200, 1e-3), NUMPY)
    assert found.norm.max() < 1e-4


def test_gradients_and_values():
    """The quadratic with the nodal values of a function, and how far its gradient is."""
    vertices = squares(8)
    tree = read("sin(3*x)*y^3 + abs(x - 1/4)", "xy")
    ends = np.array(EDGES[2]).T
    nodes = np.concatenate([vertices, (vertices[:, ends[0]] + vertices[:, ends[1]]) / 2], axis=1)
    p = quadratic(vertices, values(tree, nodes))
    for x in np.moveaxis(nodes, 1, 0):
        np.testing.assert_allclose(value_of(p, vertices, x[None])[0], values(tree, x), atol=1e-14)
    found = enclose(tree, vertices, p, np.full(128, 0.3), NUMPY, by="tilt")
    assert (found.tilt <= found.slope * (1 + 1e-9)).all()
    kappa = read("1 - 0.99*exp(-((x - 0.515)/0.01)^2)", "xy")
    found = enclose(kappa, vertices, interpolated(kappa, vertices), np.full(128, 1e-3), NUMPY)
    assert 0 < found.range.lo.min() <= 0.01
    assert found.range.lo.min() > 0.005


KINKS = (
    "max(x - 0.47, 0)*exp(y)",
    "abs(sin(7*x*y) - 0.3) + min(x, y^2)",
    "max(x^2 + y^2 - 0.49, 0)*(1 + max(y - x, 0))",
    "sqrt(0.1 + max(0.3 - x, 0))",
    "(max(x - 0.35, 0) + 0.2)^2.5/(1 + abs(y - 0.5))",
    "atan2(max(y - 0.3, 0) - 0.1, abs(x - 0.4) - 0.2)",
    "max(0.1, max(x - y, 0) - 0.05)^3",
    "tanh(5*abs(x - 0.31))",
)
OTHERS = (
    "erf(9*(x - y^2))",
    "log(0.1 + x)*(1 + y)",
    "(0.2 + x)^(1 + 9*y)",
    "exp(5*x) if x > 0.31 and not y > 0.52 else y",
    "sin(9*x) if y != x else 3",
    "sin(9*x) if y < x else 3",  # cells meet there
    "3 if x + y == 1 else sin(9*x)",
)


@pytest.mark.parametrize("text", KINKS + OTHERS)
def test_texts_are_near_polynomials(text: str):
    """No polynomial is nearer in the mean than the enclosures say that one is in all points."""
    tree, vertices, rng = read(text, "xy"), squares(5), np.random.default_rng(3)
    within = distances(tree, vertices, Frame(np.array([[0.0, 0.0], [1.0, 1.0]]), 50, MPI.COMM_SELF), np.zeros(50))
    places = rng.dirichlet(np.ones(3), 200)
    monomials = [places[:, 1] ** i * places[:, 2] ** j for i in range(5) for j in range(5 - i)]
    basis, _ = np.linalg.qr(np.column_stack(monomials))
    seen = values(tree, np.einsum("qv,nvi->nqi", places, vertices))
    rest = np.sqrt(((seen - seen @ basis @ basis.T) ** 2).mean(axis=1))
    assert (rest > 1e-5).any()
    assert (rest <= within * (1 + 1e-9) + 1e-12).all()


@pytest.mark.parametrize("text", ["3 if x == y else 7*x", "7*x if x != y else 3"])
def test_lines_have_no_measure(text: str):
    """Nor where points of quadratures and centroids are on them."""
    tree, vertices = read(text, "xy"), np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])
    zero, frame = constant(np.zeros(1), 2), Frame(np.array([[0.0, 0.0], [1.0, 1.0]]), 1, MPI.COMM_SELF)
    for found in (
        means(tree, vertices, zero, frame, np.full(1, 1e8)),
        enclose(tree, vertices, zero, np.full(1, 1e-3), NUMPY),
    ):
        assert found.mean.lo - 1e-9 <= 7 / 3 <= found.mean.hi + 1e-9
        assert math.sqrt(49 / 6) - 1e-9 <= found.norm < 4
    assert means(tree, vertices, zero, frame, np.full(1, 1e8)).mean.hi < 2.334


def test_curved_kinks_in_space():
    """The means of a function with a kink on a cylinder are found with few parts, where it cuts cells."""
    corner = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    paths = [np.cumsum(np.vstack([np.zeros(3), np.eye(3)[list(order)]]), axis=0) for order in permutations(range(3))]
    vertices = np.concatenate([corner + path for path in paths]) / 4
    tree = read("12*(x^2 + y^2)*max(x^2 + y^2 - 0.49, 0)", "xyz")
    frame = Frame(np.array([[0.0] * 3, [1.0] * 3]), len(vertices), MPI.COMM_SELF)
    found = means(tree, vertices, constant(np.zeros(len(vertices)), 3), frame, np.full(len(vertices), 1e5 / 384))
    radius = (found.mean.hi - found.mean.lo) / 2
    assert found.parts < 5000
    assert np.sqrt((radius**2).mean()) < 3.2e-3
