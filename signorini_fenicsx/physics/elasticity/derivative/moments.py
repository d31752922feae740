"""What an elastic problem sees of data on the boundary: their moments ∫ d φ_a, and what it makes of these."""

from collections.abc import Iterator
from itertools import product

import numpy as np

from signorini_fenicsx.base.arrays import Array, positions
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.derivatives.linearised import Effect, by_moments, to_values
from signorini_fenicsx.discrete.datum import Datum, datum_of
from signorini_fenicsx.discrete.vectors import PressureDatum
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.physics.elasticity.conditions import CoulombLaw, is_normal
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.problem import ElasticProblem


def on_boundary(spaces: ElasticSpaces, data: ElasticData) -> Iterator[tuple[str, Effect]]:
    """What moments of u_D, gaps and tractions make: values of û ("lift"), its right side ("load") (collective)."""
    for number, (facets, k, axes, of) in enumerate(spaces.fixed):
        places = spaces.unknowns(facets, k)
        for r in of:
            matrices = axes[:, r, None, None] * to_values(facets)
            component = data.u_D.components[r]
            yield from by_moments(spaces, f"u_D.{number}.{r}", "lift", component, facets, places, matrices)
    contact = spaces.contact
    normal = spaces.site_kinds["normal"]
    places = normal.rows_of(normal.unknown)
    matrices = np.eye(spaces.dim) / normal.rows_of(normal.measure)[:, :, None]
    yield from by_moments(spaces, "gap", "lift", data.gap, contact, places, matrices)
    yield from _tractions(spaces, data)


def _tractions(spaces: ElasticSpaces, data: ElasticData) -> Iterator[tuple[str, Effect]]:
    """Moments of g_N, which make the right side (collective)."""
    facets, dim = spaces.neumann, spaces.dim
    plain = np.broadcast_to(np.eye(dim**2), (len(facets.facets), dim**2, dim**2)).copy()
    for framed, matrices in spaces.frames[1:]:
        listed = np.isin(framed.facets, facets.facets)
        plain[np.searchsorted(facets.facets, framed.facets[listed])] = matrices[listed]
    by_component = plain.reshape(-1, dim, dim, dim**2)  # from (a, r) to the unknowns
    last = np.full(len(facets.facets), -1)
    for index, name in enumerate(data.g_N):
        last[np.isin(facets.facets, spaces.domain.facets[name]) if name else slice(None)] = index
    places = facets.blocks[:, None].astype(np.int64) * dim**2 + np.arange(dim**2)
    for index, (name, datum) in enumerate(data.g_N.items()):
        rows = np.flatnonzero(last == index)
        if isinstance(datum, PressureDatum):
            loads = [(datum.pressure, -np.einsum("narj,nr->nja", by_component[rows], facets.normals[rows]))]
        else:
            components = enumerate(datum.components)
            loads = [(component, by_component[rows, :, r].transpose(0, 2, 1)) for r, component in components]
        for r, (component, matrices) in enumerate(loads):
            key = f"g_N.{name}.{r}"
            yield from by_moments(spaces, key, "load", component, facets.take(rows), places[rows], matrices)


def of_friction(spaces: ElasticSpaces, problem: ElasticProblem, directions: Array) -> Iterator[tuple[str, Effect]]:
    """What the moments of data of friction make: a given shear ("line"), values of μ ("mu") and what is added ("g").

    Collective.

    Args:
        spaces: The spaces.
        problem: The problem.
        directions: σ_t at the sites for each unit of the bound.

    Raises:
        InputError: If a datum is not linear in x.
    """
    rough, slip, dim = spaces.rough.facets, spaces.site_kinds["slip"], spaces.dim
    sites = slip.first + np.arange(len(slip)).reshape(len(rough), dim * (dim - 1))
    shear = np.eye(dim)[:, None] * directions.reshape(len(rough), dim, dim - 1, 1)
    for of_law, law in problem.named_laws:
        for (name, given), part in product({} if is_normal(law) else law.data().items(), law.parts):
            key, facets = f"{of_law}.{name}", spaces.part(part)
            datum = datum_of(spaces, key, parsed(given, "xyz"[:dim], key))
            _check_linear(key, datum)
            rows = positions(rough, facets.facets)
            kind, places, matrices = name, dim * rows[:, None] + np.arange(dim), to_values(facets)
            if not isinstance(law, CoulombLaw):
                kind, places = "line", sites[rows]
                matrices = shear[rows].reshape(len(rows), dim * (dim - 1), dim) @ matrices
            yield from by_moments(spaces, f"{key}.{part}", kind, datum, facets, places, matrices)


def _check_linear(key: str, datum: Datum) -> None:
    """Refuse a datum in UFL that is not linear.

    Raises:
        InputError: If it is not.
    """
    if datum.pieces is None and datum.degree > 1:
        raise InputError(f"{key}: there are derivatives only if it is linear in x and y")
