"""The factorisation of one set used for others: the same solutions, few factorisations."""

import numpy as np
import pytest
from elastic import box
from mpi4py import MPI

from signorini_fenicsx.linear import kept_factors
from signorini_fenicsx.physics.elasticity import backend as elastic
from signorini_fenicsx.physics.elasticity.problem import CoulombLaw, ElasticBoundary, ElasticProblem
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD


def solved(comm: MPI.Comm, young: float, laws: list[CoulombLaw]) -> ElasticSolution:
    """A block pressed onto a curved foundation."""
    boundary = ElasticBoundary(["y0"], neumann=["y1", "x1"], fixed={"x0": "n"})
    load = {"y1": ["0", f"{-0.1 * young}"]}
    problem = ElasticProblem(f"{young}*(1 + x^2)", 0.3, g_N=load, gap="0.5*(x - 0.1)^2", laws=laws)
    return solve(box(comm, 8, [-1.0, 0.0], [1.0, 1.0]), (boundary, problem))


@pytest.mark.parallel(3)
@pytest.mark.parametrize(("young", "laws"), [(1e9, []), (1.0, [CoulombLaw(["y0"], mu=0.3)])])
def test_old_factors_solve_for_new_sets(young: float, laws: list[CoulombLaw], monkeypatch: pytest.MonkeyPatch):
    """Sites are fixed and released by the factors of another set, in any units; Coulomb's steps hardly factorise."""
    factorised = []
    impose = elastic.ConstrainedMatrix.impose
    monkeypatch.setattr(elastic.ConstrainedMatrix, "impose", lambda *given: (factorised.append(1), impose(*given))[1])
    found = solved(COMM, young, laws)
    kept = len(factorised)
    monkeypatch.setattr(kept_factors, "MOST", {2: -1})  # never
    fresh = solved(MPI.COMM_SELF, young, laws)
    assert kept <= (len(factorised) - kept) * (0.25 if laws else 0.7)
    sets = [[(step.no_flux, step.zero_trace) for step in one.outcome.history] for one in (found, fresh)]
    assert sets[0] == sets[1]
    assert found.norms() == pytest.approx(fresh.norms(), rel=1e-11)
    if COMM.size == 1:
        np.testing.assert_allclose(found.stresses / young, fresh.stresses / young, atol=1e-11)
