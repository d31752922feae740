"""P1 with scikit-fem, conjugate gradients and PyAMG's smoothed aggregation; prints JSON.

python skfem_worker.py MESH AGAIN
"""

import json
import resource
import sys
import time

import numpy as np
import pyamg
import skfem
from pdas import kkt_residual, primal_dual_active_set
from problem import gradient, load, solution
from scipy.sparse.linalg import cg
from skfem.helpers import dot, grad


def positive(values: np.ndarray) -> np.ndarray:
    """max(·, 0)."""
    return np.maximum(values, 0.0)


@skfem.BilinearForm
def stiffness(u, v, w):
    """(∇u, ∇v)."""
    return dot(grad(u), grad(v))


@skfem.LinearForm
def source(v, w):
    """(f, v)."""
    return load(w.x, positive) * v


def run(points: np.ndarray, cells: np.ndarray) -> dict[str, object]:
    """Solve once and report."""
    dim = points.shape[1]
    kind, element = {
        2: (skfem.MeshTri, skfem.ElementTriP1()),
        3: (skfem.MeshTet, skfem.ElementTetP1()),
    }[dim]
    mesh = kind(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T))
    began = time.perf_counter()
    basis = skfem.Basis(mesh, element)
    A, b = stiffness.assemble(basis), source.assemble(skfem.Basis(mesh, element, intorder=4))
    on_bottom = mesh.p[-1] < 1e-12
    boundary = mesh.boundary_nodes()
    dirichlet = np.unique(mesh.facets[:, mesh.facets_satisfying(lambda x: x[-1] > 1e-12, boundaries_only=True)])
    contact = np.setdiff1d(boundary[on_bottom[boundary]], dirichlet)
    start = np.zeros(mesh.p.shape[1])
    start[dirichlet] = solution(mesh.p[:, dirichlet], positive)
    assembled = time.perf_counter()
    seconds = {"setup": 0.0, "solve": 0.0}
    iterations: list[int] = []

    def solve(active: np.ndarray, last: np.ndarray) -> np.ndarray:
        clock = time.perf_counter()
        fixed = active.copy()
        fixed[dirichlet] = True
        u = np.where(active, 0.0, last)
        free = np.flatnonzero(~fixed)
        matrix, right = A[free][:, free], (b - A @ np.where(fixed, u, 0.0))[free]
        hierarchy = pyamg.smoothed_aggregation_solver(matrix)
        middle = time.perf_counter()
        count = [0]

        def counted(_: np.ndarray) -> None:
            count[0] += 1

        u[free], failed = cg(
            matrix, right, x0=u[free], rtol=1e-10, M=hierarchy.aspreconditioner(), maxiter=500, callback=counted
        )
        if failed:
            raise RuntimeError("conjugate gradients failed")
        iterations.append(count[0])
        seconds["setup"] += middle - clock
        seconds["solve"] += time.perf_counter() - middle
        return u

    result = primal_dual_active_set(solve, lambda u: A @ u - b, contact, start)
    total = time.perf_counter() - began
    fine = skfem.Basis(mesh, element, intorder=6)
    exact = np.stack(np.broadcast_arrays(*gradient(fine.global_coordinates(), positive)))
    error = skfem.Functional(lambda w: dot(w["u"].grad - exact, w["u"].grad - exact)).assemble(
        fine, u=fine.interpolate(result.u)
    )
    free = np.setdiff1d(np.arange(len(start)), dirichlet)
    return {
        "cells": cells.shape[0],
        "unknowns": len(start),
        "solver": "cg+pyamg",
        "steps": result.steps,
        "linear_iterations": max(iterations),
        "seconds": total,
        "assembly": assembled - began,
        **seconds,
        "recovery and rest": total - (assembled - began) - sum(seconds.values()),
        "kkt": kkt_residual(result, A @ result.u - b, free, contact),
        "flux_error": float(np.sqrt(error)),
        "peak_memory": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }


if __name__ == "__main__":
    with np.load(sys.argv[1]) as file:
        runs = [run(file["points"], file["cells"]) for _ in range(int(sys.argv[2]))]
    print(json.dumps(min(runs, key=lambda result: result["seconds"])))
