"""Whether a flow exists: what comes in has to be let out; and whether p is known, or up to a constant only.

On each connected body of fluid let F be what comes in where u_n is given, and as it grows. Elsewhere u_n has an extent:
under a law [lo, hi], on other parts any. ∇·u = 0 asks that F is in [Σ|e| lo, Σ|e| hi]. If F is an end of it, u_n is
known on all of the boundary, and no pressure. If it is both ends, p is known up to a constant; if it is the lower one,
u_n = lo holds under σ_nn of any size above a bound, so that p may fall by a constant; if it is the upper one, p may
grow.
"""

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.stokes.problem import IN_EXCESS

BALANCED = 1e-9
"""What comes in and does not go out is rounding if it is at most this share of all that passes."""
KNOWN = "u_n is known on the whole boundary of the fluid{}"
UP_TO_A_CONSTANT = ": the pressure is known up to a constant only, that with mean 0, weighted by 1/viscosity, is shown"
LOWER = ", as no more goes out than the laws ask for: any lower pressure is a solution too, and one of them is shown"
HIGHER = ", as all goes out that the laws let out: any higher pressure is a solution too, and one of them is shown"
"""What is said where p is not unique: on a line, or on a half-line."""
MOST_OF_WALLS = 3
"""Degree of u_n on walls with slip, which the v of bounds has too."""
GIVEN = 1e-9
"""u_n is given on a facet where the given components are n up to this."""


def check_flow(spaces: ElasticSpaces, data: ElasticData) -> None:
    """Make sure that what comes into each body of fluid can leave it, and note where p is not known (collective).

    Raises:
        InputError: If it cannot.
    """
    if data.gap.polynomial is None or data.gap.polynomial > MOST_OF_WALLS:
        raise InputError(f"slip: u_n must be a polynomial of degree {MOST_OF_WALLS} at most in x, y, z")
    comm, bodies = spaces.mesh.comm, spaces.bodies
    number = comm.allreduce(int(bodies.max(initial=-1)), MPI.MAX) + 1
    sums = np.zeros((4, number))  # what leaves where u_n is given, its size; what leaves elsewhere at least and at most
    at = spaces.traces.dofmap.index_map
    along, out = np.zeros((2, at.size_local + at.num_ghosts))
    for facets, k, axes, _ in spaces.fixed:
        share = np.einsum("ni,ni->n", axes, facets.outward[:, None] * facets.normals)
        along[facets.blocks] += share**2
        out[facets.blocks] += facets.measure * share * data.lift[spaces.unknowns(facets, k)].mean(axis=1)
    for cells in spaces.blocks():
        np.add.at(sums[0], bodies[cells.numbers], -data.growth(spaces, cells))
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
    for body, (left, size, least, most) in enumerate(comm.allreduce(sums).T):
        rounding = BALANCED * (size + sum(abs(end) for end in (least, most) if np.isfinite(end)))
        if not least - rounding <= -left <= most + rounding:
            outlet = "nothing lets that out" if most == least == 0 else f"elsewhere {least:.6g} to {most:.6g} can leave"
            where = f" of the fluid around ({_middle(spaces, body)})" if number > 1 else ""
            raise InputError(
                f"{IN_EXCESS} {-left:.6g} more comes in than goes out{where}, and {outlet}; the fluid is "
                "incompressible: give another u_D, or let a part be free"
            )
        at_end = [abs(end + left) <= rounding for end in (least, most)]
        if any(at_end):
            where = f" around ({_middle(spaces, body)})" if number > 1 else ""
            spaces.note(KNOWN.format(where) + (UP_TO_A_CONSTANT if all(at_end) else LOWER if at_end[0] else HIGHER))


def _middle(spaces: ElasticSpaces, body: int) -> str:
    """The middle of the box around a body of fluid, as text (collective)."""
    comm, vertices = spaces.mesh.comm, spaces.vertices[spaces.bodies == body].reshape(-1, spaces.dim)
    ends = comm.allgather((vertices.min(axis=0, initial=np.inf), vertices.max(axis=0, initial=-np.inf)))
    low, high = np.min([low for low, _ in ends], axis=0), np.max([high for _, high in ends], axis=0)
    return ", ".join(f"{x:.4g}" for x in (low + high) / 2)
