"""What reading scalar and elastic checkpoints has in common: the mesh, the facets with values, signs of damage."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.rows import find_rows
from signorini_fenicsx.base.tolerances import KKT
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.conditions import SiteConditions
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.contact.residuals import Residuals
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.meshes.domain import Domain, Marks, Part, axis_part, distribute, facet_vertices, marked_domain
from signorini_fenicsx.meshes.own import check_parts
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.methods.registry import Method
from signorini_fenicsx.output.checkpoint_file import About, Checkpoint
from signorini_fenicsx.output.checkpoint_writing import OUTCOME

SAME = 1e-3
"""Allowed relative difference between the KKT residuals of what is read and those that were written."""


def read_domain(found: Checkpoint, comm: MPI.Comm, used: Mapping[str, Sequence[str]]) -> Domain:
    """The mesh of a checkpoint with its parts (collective).

    Args:
        found: The checkpoint.
        comm: Communicator.
        used: The parts of each kind of condition; those of "inner" are inside.

    Raises:
        InputError: If these parts are not on the boundary.
    """
    about, arrays = found.about, found.arrays
    mesh = distribute(comm, arrays["points"], arrays["cells"], found.dim, together=arrays.get("together"))
    facets = {name: arrays[f"part_{index}"] for index, name in enumerate(about.parts)}
    domain = marked_domain(
        mesh,
        _parts(found),
        Marks(facets, arrays.get("inside"), tuple(about.regions)),
        curvature=about.bend,
        name=found.domain,
        is_shape=found.shape is not None,
        made=about.made,
    )
    check_parts(domain, used)
    for index, name in enumerate(facets):
        on_boundary = any(name in parts for kind, parts in used.items() if kind != "inner")
        if on_boundary and comm.allreduce(len(domain.facets[name])) != found.headers[f"part_{index}"].shape[0]:
            raise InputError(f"part '{name}' has facets that are not on the boundary")
    return domain


def rows_of_facets(found: Checkpoint, spaces: MeshSpaces) -> Indices:
    """For each facet of Γ_S of this rank its row in the checkpoint (collective).

    Raises:
        InputError: If the facets with values are not those of Γ_S.
    """
    comm = spaces.mesh.comm
    rows = find_rows(comm, facet_vertices(spaces.mesh, spaces.facets), [found.arrays["facet_vertices"]])[:, 0]
    missing, count = comm.allreduce(np.array([np.count_nonzero(rows < 0), len(rows)]))
    if missing > 0 or count != found.headers["facet_vertices"].shape[0]:
        raise InputError("its facets with values are not those of Γ_S")
    return rows


def _parts(found: Checkpoint) -> Mapping[str, Part]:
    if found.shape is not None:
        return shape_of(found.shape).parts
    return {name: axis_part(label) for name, label in found.about.parts.items()}


def damage_of(about: About, method: Method, kkt: Residuals) -> str | None:
    """Why the residuals of what was read are not those that were written, or None if they are."""
    for name, value in vars(kkt).items():
        before = (about.kkt or {}).get(name, value)
        if np.isfinite(before) and not abs(value - before) <= KKT + SAME * before:
            return f"its KKT residual {name} is {value:.1e}, and was {before:.1e} when it was written"
    known = about.kkt is not None or method.starts_from_sets
    judged = about.converged and known and about.own_residual is None  # own_residual judges the others
    violation = kkt.violation() if judged else None
    return None if violation is None else f"it claims to be a solution, but has {violation}"


def outcome_of(about: About, iterate: Iterate, conditions: SiteConditions) -> Outcome:
    """The outcome with what is the same on all ranks."""
    stored = {key: getattr(about, key) for key in OUTCOME}
    return Outcome(iterate=iterate, conditions=conditions, history=about.history, **stored)


def made[T](kind: type[T], values: dict[str, Any]) -> T:
    """An object of the package from values of a file.

    Raises:
        InputError: If it does not have these attributes.
    """
    try:
        return kind(**values)
    except TypeError:
        raise InputError(f"not a readable solution (its {kind.__name__.lower()} is not of this version)") from None
