"""A solution of viscous flow: velocity, stress, pressure."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.discrete.datum import datum_of
from signorini_fenicsx.discrete.linear_traces import blocks_of_cells
from signorini_fenicsx.discrete.points import CellPoints
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import Cells, SplitQuadrature
from signorini_fenicsx.physics.elasticity.solution import ERROR_DEGREE, ElasticSolution
from signorini_fenicsx.physics.stokes.problem import StokesProblem
from signorini_fenicsx.physics.stokes.show import shown
from signorini_fenicsx.physics.stokes.show.readings import pressure_of, quantities, traces


@dataclass(frozen=True, repr=False, kw_only=True)
class StokesSolution(ElasticSolution):
    """A discrete solution of viscous flow and how it was found, see `ElasticSolution`; `pressure` is σ_nn on laws."""

    problem: StokesProblem
    unit_keys = ("unit", "stress_unit")
    fields, lines, columns = shown.fields, shown.lines, shown.columns
    after = ""

    @property
    def gap(self) -> Array:
        """u_n on parts with laws, in means weighted by the hats of the vertices, shape (facets, d)."""
        normal, data = self.spaces.site_kinds["normal"], self.data
        return np.asarray(super().gap - normal.rows_of(data.lift[normal.unknown] + data.laws.p_h))

    @property
    def approach(self) -> str:
        """The problem and its method, in words."""
        return f"viscous flow, {self.options.algorithm_name}"

    def own_notes(self) -> list[str]:
        """A velocity of any size is right: nothing is said."""
        return []

    @collector_off()
    def flows(self) -> dict[str, float]:
        """∫ û·n over each part, outwards (collective)."""
        spaces, at_facets = self.spaces, traces(self)
        parts = {name: spaces.part(name) for name in spaces.domain.parts}
        means = {name: at_facets[part.cells, part.local].mean(axis=1) for name, part in parts.items()}
        out = [float(part.measure @ np.einsum("ni,ni->n", means[name], part.normals)) for name, part in parts.items()]
        return dict(zip(parts, spaces.mesh.comm.allreduce(np.array(out)).tolist(), strict=True))

    @collector_off()
    def quantities(self) -> dict[str, Any]:
        """Largest speed, pressure, u_n and σ_nn along laws, and the balance, see `quantities` (collective)."""
        return quantities(self)

    def of_step(self) -> dict[str, float]:
        """The row of `steps.csv`: speed, pressure, and of each part the flow, the force and the mean u (collective)."""
        about = self.quantities()
        ends = {f"pressure_{end}": about["pressure"][end] for end in ("least", "largest")}
        flows = {f"{part}_flow": flow for part, flow in self.flows().items()}
        return {"speed": about["speed"]["largest"], **ends, **flows, **self._on_parts()}

    @collector_off()
    def norms(self) -> dict[str, float]:
        """‖dev σ‖ in the energy norm, ‖σ‖ in L², and ‖u‖ (collective)."""
        return {name: value for name, value in super().norms().items() if name != "contact_force"}

    def _particular(self) -> dict[str, Any]:
        about = super()._particular() | {"flows": self.flows()}
        return {name: value for name, value in about.items() if name != "least_gap"}

    @collector_off()
    def errors(self) -> dict[str, float] | None:
        """The errors of bodies, where "energy" is that of dev σ; and ‖p − p_h‖ if p is known (collective)."""
        found, p = super().errors(), self.problem.exact_p
        if p is None:
            return found
        spaces, dim, square = self.spaces, self.spaces.dim, 0.0
        exact = datum_of(spaces, "exact.p", parsed(p, "xyz"[:dim], "[exact] p"))
        quadrature = SplitQuadrature.of_degree(dim, ERROR_DEGREE)
        pressure = pressure_of(self.stresses)
        for cells in blocks_of_cells(spaces.mesh):
            points = CellPoints(spaces.mesh, cells, quadrature.points, quadrature.weights)
            nodal = np.empty_like(pressure[cells])
            nodal[spaces.as_dolfinx(cells)] = pressure[cells]
            values = exact.values(points).reshape(len(cells), dim + 1, -1)
            off = values - np.einsum("qa,nsa->nsq", quadrature.local, nodal)
            weights = Cells(spaces.vertices[cells]).measure[:, None, None] / (dim + 1) * quadrature.weights
            square += float((weights * off**2).sum())
        return (found or {}) | {"p_L2": float(np.sqrt(spaces.mesh.comm.allreduce(square)))}
