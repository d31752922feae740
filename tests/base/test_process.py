"""What the program leaves in the user's process: nothing in cycles of references, and no setting changed."""

import gc
import os
import signal
import sys
import warnings
import weakref
from pathlib import Path

import dolfinx.jit
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx import Domain, NumericalFailure, Options, Solver, api, certify, solve
from signorini_fenicsx.meshes.meshing import build_domain


def square() -> Domain:
    """A coarse square."""
    return build_domain(MPI.COMM_WORLD, "square", 0.25, mesh="structured")


@pytest.mark.parametrize("physics", ["diffusion", "elasticity"])
def test_what_is_not_used_any_more_is_freed(physics: str):
    """Domain, spaces, data, solution and certificate go without Python's collector; nothing of ours is in a cycle."""
    problem = {
        "diffusion": api.Diffusion(f=-1.0, conditions=[api.Signorini("bottom", psi=-0.05)]),
        "elasticity": api.Elasticity(
            young=1.0,
            poisson=0.3,
            conditions=[api.Contact("bottom", friction=api.Coulomb(0.3)), api.Dirichlet("top", [0, -0.1])],
        ),
    }[physics]

    def used() -> list[weakref.ref]:
        domain = square()
        solver = Solver(domain, problem)
        solution = solver.solve(problem)
        things = (domain, solver, solution, solution.spaces, solution.data, solution.outcome, certify(solution))
        return [weakref.ref(thing) for thing in things]

    used()  # what is made once
    gc.collect()
    gc.disable()
    try:
        assert [known() for known in used()] == [None] * 7
        gc.set_debug(gc.DEBUG_SAVEALL)
        gc.collect()
        assert not [thing for thing in gc.garbage if type(thing).__module__.startswith("signorini_fenicsx")]
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
        gc.enable()


def test_nothing_of_the_process_is_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """PETSc's options, DOLFINx's compiler, hooks, handlers and the environment are as before, also after a failure."""
    monkeypatch.delenv("HOME", raising=False)  # without it ADIOS2 ends the process
    domain = square()
    contact = [api.Contact("bottom", gap="0.2*x"), api.Dirichlet("top", [0, -0.1]), api.Neumann(["left", "right"])]
    bent = api.Elasticity(young=1.0, poisson=0.3, conditions=contact)

    def state() -> list[object]:
        signals = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
        options = PETSc.Options().getAll()
        return [options, dolfinx.jit.ffcx_jit, sys.excepthook, signals, dict(os.environ), warnings.filters[:]]

    before = state()
    for problem in (api.Diffusion(f=-1.0, conditions=[api.Signorini("bottom", psi=-0.05)]), bent):
        solution = solve(domain, problem)
        certify(solution)
        solution.write(tmp_path / "results")
        with pytest.raises(NumericalFailure):
            solve(domain, problem, Options(max_iterations=1, predict=False))
    assert state() == before
