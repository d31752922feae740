"""Tables with one row for each site of Γ_S: on each rank its own rows, or on rank 0 those of all."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.parallel import gather_rows
from signorini_fenicsx.base.rows import in_digits
from signorini_fenicsx.contact.chains import Condition
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces


@dataclass(frozen=True)
class SiteTable:
    """One row per site, in columns.

    Attributes:
        part: Index into the parts of Γ_S.
        along: Coordinate along the part.
        x: The site, shape (rows, 3).
    """

    part: Indices
    along: Array
    x: Array
    name: ClassVar[str]
    """Name of its file."""
    places: ClassVar[Sequence[str]] = ("along", "x")
    """The columns by which the rows of a part are ordered."""

    def gathered(self, comm: MPI.Comm) -> Self | None:
        """The rows of all ranks on rank 0, in order; None elsewhere (collective)."""
        rows = {key: gather_rows(comm, values) for key, values in vars(self).items()}
        columns = {key: values for key, values in rows.items() if values is not None}
        return type(self)(**columns).in_order() if columns else None

    def in_order(self) -> Self:
        """The rows ordered by part and then along the part."""
        places = in_digits(np.column_stack([getattr(self, key) for key in self.places]))
        order = np.lexsort((*places.T[::-1], self.part))
        return type(self)(**{key: rows[order] for key, rows in vars(self).items()})


@dataclass(frozen=True)
class Facets(SiteTable):
    """One row per facet of Γ_S.

    Attributes:
        measure: |e|.
        vertices: Their numbers in the mesh, ascending, in a scene rows of `DrawnFields.points`, shape (facets, dim).
    """

    measure: Array
    vertices: Indices


@dataclass(frozen=True)
class FacetTable(Facets):
    """One row per facet of Γ_S, with what is known there.

    Attributes:
        p: Trace p_h, or the jump p_h.
        flux: σ_h·n.
        condition: Final condition.
        segment: Final segment, an index into the names of the segments of all laws.
    """

    p: Array
    flux: Array
    condition: npt.NDArray[np.int64]
    segment: Indices
    name = "facets"

    @property
    def middles(self) -> Array:
        """The middle of the facet of each site, shape (rows, 3)."""
        return self.x

    @property
    def shown(self) -> Indices:
        """What pictures tell apart, an index into `Surfaces.segments`."""
        return self.segment

    def in_contact(self, contact: Condition) -> Mask:
        """Mask of the sites in contact, which is this condition."""
        return self.condition == contact


@dataclass(frozen=True)
class Surfaces:
    """Facets that have a table, on each rank its own, or on rank 0 those of all.

    Attributes:
        names: Their parts.
        facets: The facets, `part` an index into these.
        table: Their values, a `SiteTable`.
        columns: The columns that are written of such a table.
        segments: Names of what `shown` of the table counts, if that is more than contact or not.
        inside: The parts that are inside the domain.
    """

    names: Sequence[str]
    facets: Facets
    table: Any
    columns: Callable[[Any], Mapping[str, npt.NDArray]]
    segments: Sequence[str] = ()
    inside: Collection[str] = ()

    def gathered(self, comm: MPI.Comm) -> Self | None:
        """The facets and the table of all ranks on rank 0; None elsewhere (collective)."""
        facets, table = self.facets.gathered(comm), self.table.gathered(comm)
        return None if facets is None else replace(self, facets=facets, table=table)


def along_parts(spaces: MeshSpaces, part: Indices, x: Array, names: Sequence[str] | None = None) -> Array:
    """The coordinate along the part for points on it, shape (points, 3), by the names of parts, or those of Γ_S."""
    along = np.empty(len(x))
    for index, name in enumerate(spaces.part_names if names is None else names):
        on_part = part == index
        along[on_part] = spaces.domain.parts[name].along(x[on_part].T)
    return along
