"""The named side of a part inside the domain, as a condition in Python tells it; for case files see `cut`."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import cell_nodes, cells_behind
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.meshes.cut import Side, on_side
from signorini_fenicsx.meshes.domain import Domain, facet_pairs, other_side


def oriented(domain: Domain, sides: Mapping[str, Side]) -> Domain:
    """The domain with these sides of parts inside it as the named ones; itself if they are (collective).

    Args:
        domain: The domain.
        sides: For each part the named side, out of which n points: a region, or a direction that points to it.

    Raises:
        InputError: If a part is not inside the domain, or a side is not clear.
    """
    facets, changed = dict(domain.facets), False
    for part, side in sides.items():
        if other_side(part) not in domain.parts:
            raise InputError(f"side: '{part}' is not a part inside the domain; domain_of has them in inner")
        named, across = facet_pairs(domain, part)
        wrong = _is_across(domain, part, side, (named, across))
        facets[part], facets[other_side(part)] = (
            np.sort(np.where(wrong, *pair)).astype(np.int32) for pair in ((across, named), (named, across))
        )
        changed |= domain.mesh.comm.allreduce(bool(wrong.any()), MPI.LOR) or part in domain.unsided
    return replace(domain, facets=facets, unsided=domain.unsided - sides.keys()) if changed else domain


def _is_across(domain: Domain, part: str, side: Side, pair: Sequence[npt.NDArray[np.int32]]) -> Mask:
    """Mask of the pairs of facets whose second one, not the first, has its cell on the named side (collective).

    Raises:
        InputError: If that is not clear.
    """
    mesh, dim, key = domain.mesh, domain.mesh.topology.dim, f"side of '{part}'"
    x, cells = mesh.geometry.x[:, :dim], np.stack([cells_behind(mesh, facets) for facets in pair], axis=1)
    corners = x[dolfinx.mesh.entities_to_geometry(mesh, dim - 1, pair[0])].reshape(-1, dim, dim)
    middle = x[cell_nodes(mesh)[cells[:, 1]]].mean(axis=1)
    wrong, unclear, why = on_side(key, side, domain.regions, cells, corners, middle)
    number = mesh.comm.allreduce(int(np.count_nonzero(unclear)))
    if number > 0:
        raise InputError(f"{key}: {counted(number, 'facet')} may be on both sides, {why}; name a region or a direction")
    return wrong
