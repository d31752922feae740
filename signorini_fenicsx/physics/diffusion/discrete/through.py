"""The flux of σ_h through parts of the boundary."""

from collections.abc import Sequence

import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import did_you_mean
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces


def flux_through(
    spaces: Spaces, sigma: fem.Function, parts: str | Sequence[str] | None, weight: Expr | float = 1.0
) -> float:
    """∫ weight·σ·n over parts of the boundary, see `Solution.flux_through` (collective).

    Raises:
        InputError: If there is no such part, or it has facets inside the domain.
    """
    domain, topology = spaces.domain, spaces.mesh.topology
    outer = dolfinx.mesh.exterior_facet_indices(topology)
    names = [parts] if isinstance(parts, str) else parts
    chosen = outer if names is None else np.empty(0, dtype=np.int32)
    for name in names or ():
        if name not in domain.facets:
            names_of_parts = ", ".join(domain.facets)
            raise InputError(f"unknown part '{name}'; there are {names_of_parts}{did_you_mean(name, domain.facets)}")
        inside = np.setdiff1d(domain.facets[name], outer)
        if spaces.mesh.comm.allreduce(len(inside)) > 0:
            raise InputError(f"part '{name}' has facets inside the domain; the flux is that through the boundary")
        chosen = np.union1d(chosen, domain.facets[name]).astype(np.int32)
    entities = fem.compute_integration_domains(fem.IntegralType.exterior_facet, topology, chosen)
    ds = ufl.Measure("ds", domain=spaces.mesh, subdomain_data=[(1, entities)])
    return spaces.integrate(weight * ufl.dot(sigma, spaces.n) * ds(1))
