"""A stress near σ_h that is admissible in the gap identity, and its distance from σ_h.

σ_h balances its loads by construction, and its tractions have the right signs, but for what the linear solver leaves of
the jumps of σ_h n, of the tractions on Γ_N and of the signs on Γ_C. If that is more than rounding the problem is solved
again under the same sets, by a factorisation, and the stress of this solve is taken.
"""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import LinearSolveFailure
from signorini_fenicsx.discrete.linear_traces import blocks_of_cells
from signorini_fenicsx.physics.elasticity.bound.clear import floors
from signorini_fenicsx.physics.elasticity.discrete.friction import shortened
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import Cells
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solve.backend import ElasticBackend
from signorini_fenicsx.physics.elasticity.solve.residuals import (
    ElasticKKT,
    elastic_kkt,
    energy_squares,
    subcell_squares,
)

ROUNDING = 1e-9
"""What is left is rounding if it is at most this share of ‖σ_h‖ in the energy norm. The bound then contains this share
in its place, which does not depend on the order of sums: the bound is the same on any number of ranks."""
OF_STRESS = 1e-13
"""Rounding as a share of the whole stress, of which a high pressure may be nearly all."""
OTHERS = 1e-6
"""Tractions on Γ_C that differ from those of the sets by more than this share of the largest stress are others."""


@dataclass(frozen=True)
class AdmissibleStress:
    """The stress y.

    Attributes:
        stresses: Its values, as in `SplitMesh.values`.
        pressure: −y_nn at the vertices of the facets of Γ_C, measured from the references of the laws and within what
            they allow: in contact ≥ 0, and 0 where there is none, shape (facets, d).
        shear: y_t at those with friction, at most the bound, shape (facets, d, d − 1).
        displacement: u of the same solve at the vertices of the cells, shape (cells, d + 1, d).
        segment: The segment of its law on which each of the vertices of Γ_C is, shape (facets, d).
        floors: A number for each facet of Γ_C that may stand for the gap, −∞ where none does, see `clear`.
        distance: A bound of ‖y − σ_h‖; infinite if too much is left.
    """

    stresses: Array
    pressure: Array
    shear: Array
    displacement: Array
    segment: Indices
    floors: Array
    distance: float


def admissible_stress(solution: ElasticSolution) -> AdmissibleStress:
    """The stress y and its distance from σ_h (collective)."""
    spaces, data, comm = solution.spaces, solution.data, solution.spaces.mesh.comm
    energy = solution.norms()["energy"]
    unit, whole = _as_energies(solution)
    rounding = max(ROUNDING * energy, OF_STRESS * whole)
    if _left(solution.kkt) * unit <= rounding:
        return _of(solution, solution.stresses, solution.outcome.iterate.p, rounding)
    try:
        again = ElasticBackend(spaces, data, direct=True).solve(solution.outcome.conditions)
    except LinearSolveFailure:
        return _of(solution, solution.stresses, solution.outcome.iterate.p, np.inf)
    stresses = spaces.split.values(again.sigma)
    kkt = elastic_kkt(spaces, data, stresses, again.p)
    enough = _left(kkt) * unit <= rounding
    distance = rounding + _energy(solution, stresses - solution.stresses) if enough else np.inf
    return _of(solution, stresses, again.p, comm.bcast(distance))


def _left(kkt: ElasticKKT) -> float:
    """What a stress lacks to be admissible, as a share of ‖σ_h‖ in L²."""
    return kkt.tractions + kkt.equilibrium + kkt.dual


def _energy(solution: ElasticSolution, stresses: Array) -> float:
    """‖τ‖ in the energy norm (collective)."""
    squares = energy_squares(solution.spaces, solution.data, stresses)
    return float(np.sqrt(solution.spaces.mesh.comm.allreduce(float(squares.sum()))))


def _as_energies(solution: ElasticSolution) -> tuple[float, float]:
    """Two norms of σ_h in L², times the root of the largest eigenvalue of 𝔸 (collective).

    The first one is without pressures that have no energy: the residuals times this are energies, see `ElasticKKT`.
    """
    spaces, data = solution.spaces, solution.data
    softest = square = 0.0
    for cells in blocks_of_cells(spaces.mesh):
        compliance = data.compliances(spaces, cells)
        softest = max(softest, float(np.linalg.eigvalsh(compliance).max(initial=0.0)))
        means = subcell_squares(data.material.seen(solution.stresses[cells])).mean(axis=1)
        square += float(means @ Cells(spaces.vertices[cells]).measure)
    softest, square = spaces.mesh.comm.allreduce(softest, MPI.MAX), spaces.mesh.comm.allreduce(square)
    return float(np.sqrt(softest * square)), float(np.sqrt(softest) * solution.norms()["sigma_L2"])


def _of(solution: ElasticSolution, stresses: Array, p: Array, distance: float) -> AdmissibleStress:
    """The stress with its tractions on Γ_C, exactly what the sets give; far away if these are others (collective)."""
    spaces, data = solution.spaces, solution.data
    balancing = data.reactions(spaces, stresses, spaces.site_kinds["slip"].of(p))
    _, reactions = solution.outcome.conditions.clean(p, balancing, 0.0)  # on springs as it is
    (normal, slip), friction = spaces.site_kinds, data.friction
    if friction.in_space and friction.springs is not None:
        sprung = np.repeat(friction.springs.somewhere, slip.shape[0] * slip.shape[1])
        slip.of(reactions)[sprung] = slip.of(balancing)[sprung]
    sizes = np.array([np.abs(each).max(initial=0.0) for each in (reactions - balancing, stresses)])
    spaces.mesh.comm.Allreduce(MPI.IN_PLACE, sizes, MPI.MAX)
    distance = np.inf if sizes[0] > OTHERS * sizes[1] else distance
    shear = shortened(slip.rows_of(reactions), friction.bound)
    pressure = normal.rows_of(np.clip(normal.of(reactions), *data.laws.chains.extent()[2:]))
    segment = normal.rows_of(solution.segment)
    displacement = spaces.displacement_values(solution.u)
    clear = floors(spaces, data, pressure, displacement)
    return AdmissibleStress(stresses, pressure, shear, displacement, segment, clear, distance)
