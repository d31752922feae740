"""The factorisation of one set used for others, and for friction in space: the same solutions, few factorisations."""

import numpy as np
import pytest
from elastic import box
from mpi4py import MPI

from signorini_fenicsx import Contact, Coulomb, Dirichlet, Domain, Elasticity, Neumann, Options, Tresca, solve
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.discrete import trace_backend as elastic
from signorini_fenicsx.linear import kept_factors
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution

COMM = MPI.COMM_WORLD


def solved(comm: MPI.Comm, young: float, friction: Coulomb | None) -> ElasticSolution:
    """A block pressed onto a curved foundation."""
    held, pressed = Dirichlet("x0", 0, components="n"), Neumann("y1", ["0", f"{-0.1 * young}"])
    conditions = [Contact("y0", gap="0.5*(x - 0.1)^2", friction=friction), held, pressed, Neumann("x1")]
    problem = Elasticity(f"{young}*(1 + x^2)", 0.3, conditions=conditions)
    return solve(box(comm, 8, [-1.0, 0.0], [1.0, 1.0]), problem)


@pytest.mark.parallel(2)
@pytest.mark.parametrize(("young", "friction"), [(1e9, None), (1.0, Coulomb(0.3))])
def test_old_factors_solve_for_new_sets(young: float, friction: Coulomb | None, monkeypatch: pytest.MonkeyPatch):
    """Sites are fixed and released by the factors of another set, in any units; Coulomb's steps hardly factorise."""
    factorised = []
    impose = elastic.ConstrainedMatrix.impose
    monkeypatch.setattr(elastic.ConstrainedMatrix, "impose", lambda *given: (factorised.append(1), impose(*given))[1])
    found = solved(COMM, young, friction)
    kept = len(factorised)
    monkeypatch.setattr(kept_factors, "MOST", {2: -1})  # never
    monkeypatch.setattr(kept_factors, "WORTH", 0)
    fresh = solved(MPI.COMM_SELF, young, friction)
    assert kept <= (len(factorised) - kept) * (0.25 if friction else 0.7)
    sets = [[(step.no_flux, step.zero_trace) for step in one.outcome.history] for one in (found, fresh)]
    assert sets[0] == sets[1]
    assert found.norms() == pytest.approx(fresh.norms(), rel=1e-11)


@pytest.mark.parametrize("law", [Tresca(0.02), Coulomb(0.3)], ids=["Tresca", "Coulomb"])
def test_one_factorisation_serves_a_predicted_problem(law: Tresca | Coulomb, monkeypatch: pytest.MonkeyPatch):
    """From what a coarser mesh tells, friction in the plane takes one factorisation on the fine mesh."""
    factorised = []
    impose = elastic.ConstrainedMatrix.impose
    monkeypatch.setattr(
        elastic.ConstrainedMatrix,
        "impose",
        lambda operator, *given: (factorised.append(operator.matrix.getSize()[0]), impose(operator, *given))[1],
    )
    problem = Elasticity(
        1.0,
        0.3,
        conditions=[Contact("y0", gap=0.02, friction=law), Neumann("y1", ["0.03", "-0.3"]), Neumann("x1")],
    )

    def solved_on(cells: int, *, predict: bool) -> ElasticSolution:
        options = Options(predict=predict, tuning=Tuning(predict_from=5_000))
        return solve(mesh(cells), problem, options, remesh=lambda factor: mesh(max(round(cells / factor), 1)))

    def mesh(cells: int) -> Domain:
        return box(MPI.COMM_SELF, cells, [0.0, 0.0], [2.0, 1.0])

    predicted = solved_on(24, predict=True)
    fine = max(factorised)
    assert factorised.count(fine) == 1
    assert all(size == fine or size < fine / 8 for size in factorised)
    cold = solved_on(24, predict=False)
    assert factorised.count(fine) > 2
    np.testing.assert_array_equal(predicted.touching, cold.touching)
    assert predicted.norms() == pytest.approx(cold.norms(), rel=1e-9)


def test_a_new_bound_leaves_the_sets_of_a_prediction():
    """By CG the sets settle once; vertices that slip backwards slipped forwards after each bound, in 16 iterations."""
    conditions = [Contact("y0", gap=0.02, friction=Coulomb(0.3)), Neumann("y1", ["-0.03", "-0.3"]), Neumann("x1")]

    def mesh(cells: int) -> Domain:
        return box(MPI.COMM_SELF, cells, [0.0, 0.0], [2.0, 1.0])

    options = Options(tuning=Tuning(predict_from=5_000, direct_up_to=5_000))
    problem = Elasticity(1.0, 0.3, conditions=conditions)
    found = solve(mesh(24), problem, options, remesh=lambda factor: mesh(max(round(24 / factor), 1)))
    assert found.outcome.linear_solver.startswith("cg")
    assert len(found.outcome.history) <= 8
    assert found.friction_states()["slip-"]["measure"] > 0


@pytest.mark.parallel(2)
@pytest.mark.parametrize(
    "law",
    [pytest.param(Tresca(0.03), id="Tresca", marks=pytest.mark.slow), pytest.param(Coulomb(0.3), id="Coulomb")],
)
def test_one_factorisation_serves_friction_in_space(law: Tresca | Coulomb, monkeypatch: pytest.MonkeyPatch):
    """It serves all steps of Newton's method, or few serve GMRES; the solution is that by a factorisation a step."""
    factorised = []
    impose = elastic.ConstrainedMatrix.impose
    monkeypatch.setattr(elastic.ConstrainedMatrix, "impose", lambda *given: (factorised.append(1), impose(*given))[1])
    top = Dirichlet("z1", ["-0.1*(y - 0.4)", "0.1*(x - 0.5)", "-0.05 + 0.03*x"])
    touching = Contact("z0", gap="0.01*x", friction=law)
    problem = Elasticity(1.0, 0.3, conditions=[touching, top, Neumann(["x0", "x1", "y0", "y1"])])

    def on(comm: MPI.Comm, most: int, worth: int) -> tuple[int, ElasticSolution]:
        factorised.clear()
        monkeypatch.setattr(kept_factors, "MOST", {3: most})
        monkeypatch.setattr(kept_factors, "WORTH", worth)
        solution = solve(box(comm, 1, [0.0] * 3, [1.0, 1.0, 0.5]), problem)
        return len(factorised), solution

    fresh, expected = on(MPI.COMM_SELF, -1, 0)
    assert fresh == len(expected.outcome.history) + 1  # the start is no step
    for most, worth, number in ((200, 0, 1), (-1, 20, fresh - 2)):
        times, found = on(COMM, most, worth)
        assert times <= number
        assert len(found.outcome.history) == len(expected.outcome.history)
        assert found.norms() == pytest.approx(expected.norms(), rel=1e-10)
