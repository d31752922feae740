"""P1 with NGSolve and its sparse Cholesky factorisation; prints JSON.

python ngsolve_worker.py MESH AGAIN
"""

import json
import resource
import sys
import time

import netgen.meshing
import ngsolve
import numpy as np
from ngsolve import dx, grad
from pdas import kkt_residual, primal_dual_active_set
from problem import gradient, load, solution


def positive(value: ngsolve.CoefficientFunction) -> ngsolve.CoefficientFunction:
    """max(·, 0)."""
    return ngsolve.IfPos(value, value, 0.0)


def boundary_of(points: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boundary facets by their vertices, and a mask of those on Γ_S."""
    corners = range(cells.shape[1])
    facets = np.concatenate([np.delete(cells, corner, axis=1) for corner in corners])
    _, first, count = np.unique(np.sort(facets, axis=1), axis=0, return_index=True, return_counts=True)
    facets = facets[first[count == 1]]
    return facets, (points[facets, -1] < 1e-12).all(axis=1)


def netgen_mesh(points: np.ndarray, cells: np.ndarray) -> ngsolve.Mesh:
    """A Netgen mesh with boundary parts `contact` and `dirichlet`."""
    dim = points.shape[1]
    mesh = netgen.meshing.Mesh(dim=dim)
    mesh.AddPoints(np.pad(points, ((0, 0), (0, 3 - dim))))
    if dim == 2:
        mesh.Add(netgen.meshing.FaceDescriptor(surfnr=1, domin=1, bc=1))
    facets, on_contact = boundary_of(points, cells)
    for number, (name, mask) in enumerate((("contact", on_contact), ("dirichlet", ~on_contact)), start=1):
        if dim == 3:
            mesh.Add(netgen.meshing.FaceDescriptor(surfnr=number, domin=1, domout=0, bc=number))
        mesh.AddElements(dim=dim - 1, index=number, data=facets[mask].astype(np.int32), base=0)
        mesh.SetBCName(number - 1, name)
    mesh.AddElements(dim=dim, index=1, data=cells.astype(np.int32), base=0)
    return ngsolve.Mesh(mesh)


def run(points: np.ndarray, cells: np.ndarray) -> dict[str, object]:
    """Solve once and report."""
    mesh = netgen_mesh(points, cells)
    x = (ngsolve.x, ngsolve.y, ngsolve.z)[: points.shape[1]]
    began = time.perf_counter()
    space = ngsolve.H1(mesh, order=1, dirichlet="dirichlet")
    u, v = space.TnT()
    a = ngsolve.BilinearForm(grad(u) * grad(v) * dx, symmetric=True).Assemble()
    b = ngsolve.LinearForm(load(x, positive) * v * dx(bonus_intorder=3)).Assemble()
    field = ngsolve.GridFunction(space)
    field.Set(solution(x, positive), definedon=mesh.Boundaries("dirichlet"))
    free = np.flatnonzero(np.array(space.FreeDofs()))
    contact = np.intersect1d(np.flatnonzero(np.array(space.GetDofs(mesh.Boundaries("contact")))), free)
    assembled = time.perf_counter()
    seconds = {"setup": 0.0, "solve": 0.0}

    def residual(values: np.ndarray) -> np.ndarray:
        vector = field.vec.CreateVector()
        vector.FV().NumPy()[:] = values
        return (a.mat * vector - b.vec).Evaluate().FV().NumPy().copy()

    def solve(active: np.ndarray, last: np.ndarray) -> np.ndarray:
        clock = time.perf_counter()
        remaining = ngsolve.BitArray(space.FreeDofs())
        for dof in np.flatnonzero(active):
            remaining.Clear(int(dof))
        inverse = a.mat.Inverse(remaining, inverse="sparsecholesky")
        middle = time.perf_counter()
        field.vec.FV().NumPy()[:] = np.where(active, 0.0, last)
        field.vec.data -= inverse * (a.mat * field.vec - b.vec)
        seconds["setup"] += middle - clock
        seconds["solve"] += time.perf_counter() - middle
        return field.vec.FV().NumPy().copy()

    result = primal_dual_active_set(solve, residual, contact, field.vec.FV().NumPy().copy())
    total = time.perf_counter() - began
    field.vec.FV().NumPy()[:] = result.u
    difference = grad(field) - ngsolve.CF(gradient(x, positive))
    return {
        "cells": len(cells),
        "unknowns": space.ndof,
        "solver": "sparsecholesky",
        "steps": result.steps,
        "linear_iterations": 1,
        "seconds": total,
        "assembly": assembled - began,
        **seconds,
        "recovery and rest": total - (assembled - began) - sum(seconds.values()),
        "kkt": kkt_residual(result, residual(result.u), free, contact),
        "flux_error": float(np.sqrt(ngsolve.Integrate(difference * difference, mesh, order=6))),
        "peak_memory": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }


if __name__ == "__main__":
    with np.load(sys.argv[1]) as file:
        runs = [run(file["points"], file["cells"]) for _ in range(int(sys.argv[2]))]
    print(json.dumps(min(runs, key=lambda result: result["seconds"])))
