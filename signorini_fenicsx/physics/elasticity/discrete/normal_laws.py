"""Laws in the normal direction on Γ_C: monotone graphs between the opening p = g − u_n and the pressure −σ_nn.

Where two bodies touch p = g − [u_n]. How a graph is one of facet vertices: `discrete/vertex_laws.py`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.contact.law import Graph, Law
from signorini_fenicsx.discrete.datum import DEGREES, Datum
from signorini_fenicsx.discrete.part_laws import (
    PartLaw,
    data_of_law,
    parts_of_laws,
    refuse_data,
)
from signorini_fenicsx.discrete.points import FacetPoints
from signorini_fenicsx.discrete.vertex_laws import VertexLaws, vertex_laws
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces


@dataclass(frozen=True)
class NormalLaw(PartLaw):
    """A law and where it holds; `rows` are those of `ElasticSpaces.contact`."""

    def graph(self, points: FacetPoints) -> Graph:
        """The graph in points."""
        return self.law.graph({name: datum.values(points).ravel() for name, datum in self.data.items()})

    def reference(self, points: FacetPoints) -> tuple[Array, Array]:
        """The opening and the pressure at the reference in points, shape (facets, points) each."""
        number = points.shape[0] * points.shape[1]
        opening, pressure = (np.broadcast_to(each, number) for each in self.graph(points).reference)
        return opening.reshape(points.shape), pressure.reshape(points.shape)

    @property
    def polynomial(self) -> int | None:
        """The degree of the opening at the reference, as if this were a datum; None if it is not quadratic."""
        return 2 if self.moves_only() else None

    def values(self, points: FacetPoints) -> Array:
        """The opening at the reference in points, shape (facets, points)."""
        return self.reference(points)[0]

    def varying(self) -> Mapping[str, Datum]:
        """The data that are no numbers."""
        return {name: datum for name, datum in self.data.items() if datum.polynomial != 0}

    def moves_only(self) -> bool:
        """Whether along a facet the graph is moved at most, by a quadratic opening and a linear pressure."""
        varying = self.varying()
        if not varying:
            return True
        values: Mapping[str, Array] = {name: np.ones(1) for name in self.data}
        graph = self.law.graph(values)
        if len(graph.corners) != 1 or graph.corners[0] is not graph.reference:
            return False
        most = {
            name: degree
            for degree, each in zip((2, 1), graph.reference, strict=True)
            for name in values
            if values[name] is each
        }
        degrees = {
            name: DEGREES[1] if datum.polynomial is None else datum.polynomial for name, datum in varying.items()
        }
        return all(degree <= most.get(name, 0) for name, degree in degrees.items())


def normal_laws(spaces: ElasticSpaces, laws: Sequence[tuple[str, Law]]) -> VertexLaws:
    """Read the laws, each with its name in messages; elsewhere Γ_C is in contact (collective).

    Raises:
        InputError: If data are not what their law allows; the message says where.
    """
    parts_of_laws(spaces, laws)
    parts = []
    for name, law in laws:
        parts.append(NormalLaw(law, name, spaces.rows_on(*law.parts), data_of_law(spaces, law, name)))
        refuse_data(spaces, parts[-1])
    return vertex_laws(spaces, parts)
