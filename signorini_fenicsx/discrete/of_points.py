"""Data that are functions of points: as functions on the mesh."""

from collections.abc import Callable

import basix
import basix.ufl
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError

type OfPoints = Callable[[Array], npt.ArrayLike]
"""Values of shape (*shape, n) in points of shape (3, n)."""
REAL = "biuf"
"""Kinds of NumPy's types for truth values and real numbers."""


def interpolated(mesh: dolfinx.mesh.Mesh, name: str, given: OfPoints, *, continuous: bool) -> fem.Function:
    """A function of points as a piecewise quadratic one on the mesh; if it may jump, by inner points (collective).

    Raises:
        InputError: On all ranks, if it fails or does not give a real number for each point on one of them.
    """
    wrong: list[InputError] = []

    def values(x: Array) -> Array:
        try:
            return _values(name, given, x)
        except InputError as error:
            wrong.append(error)
            return np.zeros((*shape, x.shape[1]))

    shape: tuple[int, ...] = ()
    first_point = mesh.geometry.x[:1].T
    seen = mesh.comm.allgather(values(first_point).shape[:-1] if first_point.size > 0 else None)
    shape = next(each for each in seen if each is not None)
    variant = basix.LagrangeVariant.gll_warped if continuous else basix.LagrangeVariant.legendre
    element = basix.ufl.element("P", mesh.basix_cell(), 2, variant, shape=shape, discontinuous=not continuous)
    function = fem.Function(fenicsx.function_space(mesh, element), name=name)
    function.interpolate(lambda x: values(x).reshape(-1, x.shape[1]))
    first = max(mesh.comm.allgather(str(wrong[0]) if wrong else ""))
    if first:
        raise wrong[0] if wrong else InputError(first)
    return function


def _values(name: str, given: OfPoints, x: Array) -> Array:
    """What a function gives in points.

    Raises:
        InputError: If it fails, or that is not a real number for each point.
    """
    what = f"[problem] {name}: the function of points of shape {x.shape}"
    try:
        values = np.asarray(given(x))
    except Exception as error:
        raise InputError(f"{what} fails: {type(error).__name__}: {error}") from error
    if values.shape[-1:] != x.shape[1:]:
        raise InputError(f"{what} must give one value for each, not an array of shape {values.shape}")
    if values.dtype.kind not in REAL:
        raise InputError(f"{what} must give real numbers, not {values.dtype}")
    return values
