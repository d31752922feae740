"""The data of a case for the theorem: they are enclosed, never only sampled."""

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.reference_cells import EDGES
from signorini_fenicsx.expressions import Tree, interval, values
from signorini_fenicsx.expressions.given import Rows
from signorini_fenicsx.expressions.intervals import Elementary, Interval, enclosing
from signorini_fenicsx.expressions.simplices import INSIDE, Quadratic, constant, quadratic
from signorini_fenicsx.rigorous.discrete import Discrete
from signorini_fenicsx.rigorous.enclosures import Enclosure, enclose
from signorini_fenicsx.rigorous.simplices import Simplices, root, squared, total, with_midpoints
from signorini_fenicsx.rigorous.tensor import Tensor, near

FINE = {"norm": 1e-9, "tilt": 1e-3, "mean": 1e-9}
"""Bisection stops at an uncertainty below this share of the size, or of the slope, of the data."""
IN_MEANS = 1e-2
"""Bisection for means stops at this share of the variation on a simplex, times h divided by the size of the domain. The
last factor is needed because errors of the means add up along the tree of `balance`."""


@dataclass(frozen=True)
class Deviation(Enclosure):
    """An expression e on simplices, as a polynomial p and enclosures of e − p.

    Attributes:
        nodes: p in the nodes of P2, vertices first, then edges as in `EDGES`.
    """

    nodes: Interval


def deviation(
    tree: Tree,
    vertices: Array,
    elementary: Elementary,
    *,
    name: str,
    by: Literal["mean", "norm", "tilt"] = "norm",
    degree: int = 2,
    wanted: Array | None = None,
    order: int = 1,
) -> Deviation:
    """Enclose an expression on simplices.

    Args:
        tree: The expression.
        vertices: Vertices of the simplices, shape (n, k + 1, d).
        elementary: Proven bounds of exp, sin, ….
        name: Name of the expression in the case.
        by: The quantity for which simplices are bisected.
        degree: Degree of p, 1 or 2.
        wanted: Values of p in the nodes of P2; None for those of the expression.
        order: Of the errors that the means are to be small beside.

    Raises:
        InputError: If there are no finite bounds.
    """
    dim = vertices.shape[1] - 1
    middle = vertices.mean(axis=1, keepdims=True)
    inside = middle + INSIDE * (vertices - middle)  # so data that jump between simplices come from the right side
    sampled = values(tree, places(with_midpoints(enclosing(inside)))) if wanted is None else wanted
    if degree == 1:
        ends = np.array(EDGES[dim]).T
        sampled[:, dim + 1 :] = (sampled[:, ends[0]] + sampled[:, ends[1]]) / 2
    p = _polynomial(inside if wanted is None else vertices, sampled, linear=degree == 1)
    size = float(np.nan_to_num(np.abs(sampled)).max(initial=0.0))
    extent = float(np.ptp(vertices.reshape(-1, vertices.shape[-1]), axis=0).max()) if vertices.size else 1.0
    tolerance = np.full(len(vertices), FINE[by] * size / (extent if by == "tilt" else 1.0))
    if by == "mean" and len(vertices):
        tolerance += IN_MEANS * len(vertices) ** (-order / dim) * np.nan_to_num(np.ptp(sampled, axis=1))
    enclosed = enclose(tree, vertices, p, tolerance, elementary, by)
    reached = enclosed.norm + (enclosed.tilt if by == "tilt" else 0.0)
    if not np.isfinite(reached).all():
        what = "no certain bounds of it and its gradient" if by == "tilt" else "no certain bounds"
        raise InputError(f"{name} has {what} {near(enclosed.place[:, None], np.where(np.isfinite(reached), 0, -1))}")
    nodes = _in_nodes(p, vertices, with_midpoints(enclosing(vertices)))
    return Deviation(**vars(enclosed), nodes=nodes)


def places(x: Interval) -> Array:
    """The middle of the intervals, as floats."""
    return np.asarray((x.lo + x.hi) / 2)


def enclosed_at(tree: Tree, x: Interval, elementary: Elementary) -> Interval:
    """The values of a tree in points, shape (…, d)."""
    return interval(tree, {axis: x[..., k] for k, axis in enumerate("xyz"[: x.lo.shape[-1]])}, elementary)


def smallest(tree: Tree, vertices: Array, elementary: Elementary) -> Array:
    """Lower bound of an expression on each simplex; simplices may be points."""
    if vertices.shape[1] == 1:
        lowest = enclosed_at(tree, enclosing(vertices[:, 0]), elementary).lo
    else:
        p = constant(np.zeros(len(vertices)), vertices.shape[2])
        none = np.zeros(len(vertices))
        lowest = enclose(tree, vertices, p, none, elementary).range.lo
    return np.where(np.isnan(lowest), -np.inf, lowest)


def _polynomial(vertices: Array, sampled: Array, *, linear: bool) -> Quadratic:
    """A polynomial with floats as coefficients and about these values in the nodes; a constant is exact."""
    p = quadratic(vertices, sampled)
    same = (sampled == sampled[:, :1]).all(axis=1)
    value = np.where(same, sampled[:, 0], p.value)
    gradient = np.where(same[:, None], 0.0, p.gradient)
    return Quadratic(value, gradient, np.where((same | linear)[:, None, None], 0.0, p.hessian))


def _in_nodes(p: Quadratic, vertices: Array, x: Interval) -> Interval:
    """Enclosures of a polynomial, whose coefficients are floats, in the nodes of P2."""
    arms = x - vertices.mean(axis=1)[:, None]
    linear = total(arms * p.gradient[:, None])
    bent = total(total(arms[..., :, None] * arms[..., None, :] * (p.hessian / 2)[:, None]))
    return linear + bent + p.value[:, None]


type Term = tuple[Tree, Mask, Iterable[Any]]
"""A tree, the mask of its cells, and the entries in which it is there."""


def linear_on(
    vertices: Array, shape: tuple[int, ...], terms: Iterable[Term], elementary: Elementary, name: str
) -> tuple[Interval, Array]:
    """Arrays whose entries are sums of trees, linear on each cell, at its vertices, and bounds of what is left of each.

    Args:
        vertices: Of the cells, shape (cells, d + 1, d).
        shape: Of the arrays.
        terms: The trees.
        elementary: As in `deviation`.
        name: Likewise.
    """
    corners, deviations = Interval(*np.zeros((2, *vertices.shape[:2], *shape))), np.zeros((len(vertices), *shape))
    for tree, cells, entries in terms:
        found = deviation(tree, vertices[cells], elementary, name=name, degree=1)
        for entry in entries:
            corners[cells, :, *entry] += found.nodes[:, : vertices.shape[1]]
            deviations[cells, *entry] += found.largest * (1 + 1e-15)
    return corners, deviations


@dataclass(frozen=True)
class Given:
    """The trees of a case's data, and bounds of elementary functions.

    Attributes:
        f, u_D, g_N, psi, q_S: As in `physics.diffusion.problem.Problem`, as trees.
        kappa: κ as a matrix of trees, 1 × 1 for a scalar; by region, or under "" for all of Ω. Only the entries on and
            above the diagonal are used.
        elementary: Proven bounds of exp, sin, ….
    """

    f: Tree
    u_D: Tree
    g_N: Tree
    psi: Tree
    q_S: Tree
    kappa: Mapping[str, Rows]
    elementary: Elementary

    @classmethod
    def of(cls, trees: Mapping[str, Tree | Rows], elementary: Elementary) -> Self:
        """Take the trees of `Data.trees`.

        Raises:
            InputError: If a datum is not an expression.
        """
        names = ("f", "u_D", "g_N", "psi", "q_S")
        kappa = {
            name.removeprefix("kappa").removeprefix("."): value if isinstance(value, tuple | list) else [[value]]
            for name, value in trees.items()
            if name.startswith("kappa")
        }
        missing = [name for name in names if name not in trees] + ["kappa"] * (not kappa)
        if missing:
            raise InputError(f"{', '.join(missing)} must be an expression, as in a case file")
        return cls(**{name: trees[name] for name in names}, kappa=kappa, elementary=elementary)  # type: ignore[arg-type]

    def conductivity(self, cells: Simplices, discrete: Discrete) -> Tensor:
        """κ on all cells.

        Raises:
            InputError: If it is not certainly positive definite, or varies too much within a cell.
        """
        names, inside = discrete.regions
        count, size = len(cells.vertices), max(len(rows) for rows in self.kappa.values())
        terms: list[Term] = []
        is_set = np.zeros(count, dtype=bool)
        for region, rows in self.kappa.items():
            chosen = np.ones(count, dtype=bool) if region == "" else inside[:, names.index(region)]
            is_set |= chosen
            for i, j in itertools.combinations_with_replacement(range(size), 2):
                if len(rows) > 1 or size == 1 or i == j:
                    terms.append((rows[i % len(rows)][j % len(rows)], chosen, {(i, j), (j, i)}))
        if not is_set.all():
            raise InputError("kappa must be an expression in all regions, as in a case file")
        corners, deviations = linear_on(cells.vertices, (size, size), terms, self.elementary, "kappa")
        return Tensor(cells, corners, root(total(total(squared(enclosing(deviations))))).hi)
