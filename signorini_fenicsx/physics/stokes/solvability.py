"""Whether a flow exists: what comes in has to be let out; and whether p is known, or up to a constant only.

On each connected body of fluid let F be what comes in where u_n is given. Elsewhere u_n has an extent: under a law
[lo, hi], on other parts any. ∇·u = 0 asks that F is in [Σ|e| lo, Σ|e| hi]. If F is an end of it, u_n is known on all of
the boundary, and no pressure: p may then grow by a constant.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces

BALANCED = 1e-9
"""What comes in and does not go out is rounding if it is at most this share of all that passes."""
GIVEN = 1e-9
"""u_n is given on a facet where the given components are n up to this."""


def check_flow(spaces: ElasticSpaces, data: ElasticData) -> None:
    """Make sure that what comes into each body of fluid can leave it, and note where p is not known (collective).

    Raises:
        InputError: If it cannot.
    """
    comm, bodies = spaces.mesh.comm, spaces.bodies
    number = comm.allreduce(int(bodies.max(initial=-1)), MPI.MAX) + 1
    sums = np.zeros((4, number))  # what leaves where u_n is given, its size; what leaves elsewhere at least and at most
    at = spaces.traces.dofmap.index_map
    along, out = np.zeros((2, at.size_local + at.num_ghosts))
    for facets, k, axes, _ in spaces.fixed:
        share = np.einsum("ni,ni->n", axes, facets.outward[:, None] * facets.normals)
        along[facets.blocks] += share**2
        out[facets.blocks] += facets.measure * share * data.lift[spaces.unknowns(facets, k)].mean(axis=1)
    for facets in (spaces.dirichlet, spaces.neumann):
        given, of = along[facets.blocks] > 1 - GIVEN, bodies[facets.cells]
        for row, values in enumerate((out[facets.blocks], np.abs(out[facets.blocks]))):
            np.add.at(sums[row], of[given], values[given])
        sums[2, of[~given]], sums[3, of[~given]] = -np.inf, np.inf
    normal, contact = spaces.site_kinds["normal"], spaces.contact
    ends = np.sort(np.stack([data.lift[normal.unknown] - end for end in data.laws.chains.extent()[:2]]), axis=0)
    outward = np.repeat(contact.outward, spaces.dim)
    low, high = np.sort(outward * ends, axis=0) * normal.measure
    for row, values in ((2, low), (3, high)):
        np.add.at(sums[row], np.repeat(bodies[contact.cells], spaces.dim), values)
    for left, size, least, most in comm.allreduce(sums).T:
        rounding = BALANCED * (size + sum(abs(end) for end in (least, most) if np.isfinite(end)))
        if not least - rounding <= -left <= most + rounding:
            outlet = "nothing lets that out" if most == least == 0 else f"elsewhere {least:.6g} to {most:.6g} can leave"
            raise InputError(
                f"[problem] u_D: where u_n is given {-left:.6g} more comes in than goes out, and {outlet}; the "
                "fluid is incompressible: give another u_D, or let a part be free"
            )
        if min(most + left, -left - least) <= rounding:
            spaces.note(
                "u_n is known on the whole boundary of the fluid: the pressure is known up to a constant only, that "
                "with mean 0, weighted by 1/viscosity, is shown"
            )
