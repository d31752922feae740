"""How wrong a displacement is, by a stress that is near the exact one; see `certificate.certify`."""

import numpy as np
import ufl
from dolfinx import fem

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.certificate.certify import FieldBound, bound_by_parts
from signorini_fenicsx.discrete.linear_traces import opposite
from signorini_fenicsx.discrete.points import CellPoints
from signorini_fenicsx.physics.elasticity.bound.certify import certificate_of
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import to_entries, to_matrices
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solve.residuals import energy_squares


def field_bound(solution: ElasticSolution, v: fem.Function) -> FieldBound:
    """The bounds of a displacement (collective).

    Raises:
        InputError: If the material varies within cells: ℂ(ε(v) − ε₀) is then not linear on each cell.
    """
    spaces, data = solution.spaces, solution.data
    material = data.material
    if not material.uniform or material.degree is None or material.degree > 1:
        raise InputError("v: with elastic data that vary within regions there is no bound of displacements")
    mesh, dim = spaces.mesh, spaces.dim
    certificate = certificate_of(solution)
    if certificate.if_none:
        raise InputError(f"v: there is no bound, {certificate.if_none}")
    cells = np.arange(len(spaces.order), dtype=np.int32)
    corners = np.vstack([np.zeros(dim), np.eye(dim), np.full(dim, 1 / (dim + 1))])
    points = CellPoints(mesh, cells, corners, np.empty(0))
    strain = to_entries(points.of_ufl(ufl.grad(v))) - material.strain(points)
    stiffness = np.linalg.pinv(material.compliance(points), hermitian=True)  # of a fluid without what has no energy
    stress = to_matrices((stiffness @ strain[..., None])[..., 0])
    in_order = np.take_along_axis(stress, spaces.order[:, :, None, None], axis=1)
    at_subcells = np.empty((len(cells), dim + 1, dim + 1, dim, dim))
    at_subcells[:, :, :dim] = in_order[:, opposite(dim)]
    at_subcells[:, :, dim] = stress[:, None, dim + 1]
    squares = np.maximum(energy_squares(spaces, data, at_subcells - solution.stresses), 0.0)
    return bound_by_parts(solution, certificate, (squares, squares), solution.norms()["energy"])
