"""Results that must agree: those of all ranks and of one alone, those of both backends."""

from collections.abc import Callable

import numpy as np
import pytest
from mpi4py import MPI

from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.physics.diffusion.case import Case

COMM = MPI.COMM_WORLD


def on_one_rank[T](work: Callable[[MPI.Comm], T]) -> T:
    """What `work` returns on rank 0 alone, on all ranks of MPI.COMM_WORLD (collective)."""
    return COMM.bcast(work(MPI.COMM_SELF) if COMM.rank == 0 else None)


def assert_same_iterates(case: Case, tolerance: float, tuning: Tuning | None = None) -> None:
    """Every algorithm has the same sets and the same final σ, u, p with both backends (collective)."""
    domain = mesh_case(case, COMM)
    for algorithm in ("alg1", "alg2", "alg3", "alg4"):
        mixed, facet = (
            solve_case(
                case.with_values({"solve.algorithm": algorithm, "solve.backend": backend, "solve.eps": 1e-6}),
                COMM,
                domain=domain,
                tuning=tuning,
            )
            for backend in ("mixed", "hybrid")
        )
        for a, b in zip(mixed.outcome.history, facet.outcome.history, strict=True):
            assert (a.no_flux, a.zero_trace, a.robin, a.changed, a.clipped) == (
                b.no_flux,
                b.zero_trace,
                b.robin,
                b.changed,
                b.clipped,
            )
            assert a.sigma_change == pytest.approx(b.sigma_change, abs=1e-8)
        np.testing.assert_array_equal(mixed.outcome.conditions.kind, facet.outcome.conditions.kind)
        for one, two in [(mixed.sigma, facet.sigma), (mixed.u, facet.u), (mixed.p, facet.p)]:
            np.testing.assert_allclose(one.x.array, two.x.array, atol=tolerance)
