"""What a physics declares of its solutions once: their fields, from which all files of fields follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array

type Fields = Mapping[str, Sequence[Field]]
"""The fields of each file by its name: those of `IN_CELLS` have rows of cells, others rows of facets of Γ_S."""

IN_CELLS = "solution"


@dataclass(frozen=True)
class Field:
    """A field of a solution, on each rank in its own cells or on its own facets of Γ_S.

    Attributes:
        name: Its name in all files.
        values: Shape (rows, …, …). The axes between those of the rows and those of a value are the nodes: none for a
            constant; the vertices of a linear field, in the order of `MeshSpaces.nodes` or `corners`; or the subcells
            and their vertices.
        order: Number of axes of a value: 0 of a number, 1 of a vector, 2 of a matrix in space.
        at_points: Whether XDMF has its means around the points of the mesh too, as warping needs them.
        names: What its values 0, 1, … are called, if they are numbers of states.
        cell_means: Its means over the cells, where these are not the means over the nodes.
    """

    name: str
    values: npt.NDArray
    order: int = 0
    at_points: bool = False
    names: Sequence[str] = ()
    cell_means: npt.NDArray | None = None

    @property
    def nodes(self) -> int:
        """The number of axes for nodes."""
        return self.values.ndim - 1 - self.order

    def means(self) -> Field:
        """The means over cells or facets; all subcells of a cell are as large."""
        means = self.values.mean(axis=tuple(range(1, 1 + self.nodes))) if self.cell_means is None else self.cell_means
        return replace(self, values=means, at_points=False, cell_means=None)

    def with_derived(self) -> list[Field]:
        """The field with what follows from it: the length of a vector, the von Mises and principal stresses."""
        fields = [self]
        if self.order == 1:
            fields.append(Field(f"{self.name}_norm", np.linalg.norm(self.values, axis=-1)))
        if self.order == 2:
            principal = np.linalg.eigvalsh(self.values)[..., ::-1]
            fields.append(Field("von_mises", von_mises(self.values)))
            fields += [Field(f"principal_{k + 1}", principal[..., k]) for k in range(3)]
        return fields


def von_mises(stresses: Array) -> Array:
    """Equivalent stress of matrices in space, shape (…, 3, 3)."""
    deviator = stresses - np.einsum("...ii->...", stresses)[..., None, None] / 3 * np.eye(3)
    return np.sqrt(1.5 * (deviator**2).sum(axis=(-1, -2)))
