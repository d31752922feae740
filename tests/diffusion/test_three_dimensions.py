"""All algorithms and both backends on the three-dimensional shapes, and their pictures."""

from pathlib import Path

import numpy as np
import pytest
from agreement import assert_same_iterates
from commands import signorini
from mpi4py import MPI

from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.solving import solve_case

COMM = MPI.COMM_WORLD
COARSE = {"cube": 0.5, "lprism": 0.7, "ball": 0.8}


@pytest.mark.slow
@pytest.mark.parallel([2])
def test_backends_agree():
    for name, h in COARSE.items():
        assert_same_iterates(load_case(name).with_values({"solve.h": h}), 1e-11)


@pytest.mark.parallel([1])
def test_algorithms_agree():
    """Methods for the multipliers agree up to rounding, SNES and penalties up to about ε."""
    for name, h in COARSE.items():
        case = load_case(name).with_values({"solve.h": h, "solve.eps": 1e-8})
        domain = mesh_case(case, COMM)
        first = solve_case(case, domain=domain)
        assert 0 < first.contact[0] < first.summary()["signorini_facets"]
        for algorithm, tolerance in (("alg2", 1e-11), ("alg3", 1e-6), ("alg4", 1e-6), ("snes1", 1e-6), ("vi", 1e-9)):
            other = solve_case(case.with_values({"solve.algorithm": algorithm}), domain=domain)
            assert other.contact == pytest.approx(first.contact)
            for a, b in [(first.sigma, other.sigma), (first.u, other.u), (first.p, other.p)]:
                np.testing.assert_allclose(a.x.array, b.x.array, atol=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lprism", "ball"])
def test_pictures(tmp_path: Path, name: str):
    done = signorini(tmp_path, "solve", name, "--h", str(COARSE[name]), "--plot")
    assert done.returncode == 0, done.stderr
    for picture in ("u.png", "sigma.png", "signorini.png"):
        assert (tmp_path / "results" / name / picture).stat().st_size > 10_000
