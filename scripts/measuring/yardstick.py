"""The yardstick f₀: one linear solve of the facet system with known facet conditions, from assembly to recovery.

It is the solver of version 0.2 and stays as it is: whole runs and later versions are measured against it. Γ_S facets
below the middle of Γ_S have p = 0, the others σ·n = 0. It prints JSON: cells, unknowns, iterations, and the seconds of
assembly, set-up, solve and recovery, each the longest over the ranks.
"""

import json
import time

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import basix.ufl
import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix, assemble_vector, create_vector
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.meshes.domain import Domain

COMM = MPI.COMM_WORLD


def yardstick(name: str, h: str) -> None:
    """Run once on a small mesh, so that no compilation is timed, and then on the mesh of the case."""
    case = load_case(name)
    for size in (0.2, h):
        case = case.with_values({"solve.h": size})
        domain = mesh_case(case, COMM)
        COMM.Barrier()
        result = solve(domain, case.boundary.signorini)
    if COMM.rank == 0:
        print(json.dumps(result))


def solve(domain: Domain, signorini: list[str]) -> dict[str, float]:
    """Assemble, set up, solve and recover (collective)."""
    mesh = domain.mesh
    clock = [time.perf_counter()]
    kinds = {"CR": basix.ufl.element("CR", mesh.basix_cell(), 1), "P1": ("Lagrange", 1)}
    facets, vertices = (fem.functionspace(mesh, kind) for kind in kinds.values())
    fixed = fixed_facets(domain, signorini)
    matrices = []
    for space in (facets, vertices):
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        dofs = fem.locate_dofs_topological(space, mesh.topology.dim - 1, fixed)
        zero = fem.dirichletbc(PETSc.ScalarType(0), dofs, space)
        matrix = assemble_matrix(fem.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx), bcs=[zero])
        matrix.assemble()
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        matrices.append((matrix, dofs[dofs < space.dofmap.index_map.size_local]))
    (A, fixed_dofs), (coarse, fixed_vertices) = matrices
    b = assemble_vector(fem.form(ufl.TestFunction(facets) * ufl.dx))
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    b.array_w[fixed_dofs] = 0.0
    clock.append(time.perf_counter())
    ksp = multigrid(A, coarse, inclusion(vertices, facets, fixed_vertices, fixed_dofs))
    clock.append(time.perf_counter())
    x = create_vector(facets)
    ksp.solve(b, x)
    clock.append(time.perf_counter())
    recover(facets, x)
    clock.append(time.perf_counter())
    seconds = np.diff(clock)
    COMM.Allreduce(MPI.IN_PLACE, seconds, op=MPI.MAX)
    return {
        "cells": mesh.topology.index_map(mesh.topology.dim).size_global,
        "unknowns": facets.dofmap.index_map.size_global,
        "iterations": ksp.getIterationNumber(),
        "residual": ksp.getResidualNorm(),
        "total": float(seconds.sum()),
        **dict(zip(("assembly", "setup", "solve", "recovery"), seconds.tolist(), strict=True)),
    }


def fixed_facets(domain: Domain, signorini: list[str]) -> np.ndarray:
    """Facets of Γ_D, and those of Γ_S that lie below its middle (collective)."""
    mesh = domain.mesh
    outer = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    contact = np.unique(np.concatenate([domain.facets[part] for part in signorini]))
    x = dolfinx.mesh.compute_midpoints(mesh, mesh.topology.dim - 1, contact)[:, 0]
    middle = COMM.allreduce(x.sum()) / COMM.allreduce(len(x))
    return np.union1d(np.setdiff1d(outer, contact), contact[x < middle]).astype(np.int32)


def inclusion(vertices: fem.FunctionSpace, facets: fem.FunctionSpace, *fixed: np.ndarray) -> PETSc.Mat:
    """The inclusion of P1 in the Crouzeix-Raviart functions, zero where one of them is fixed (collective)."""
    of_cell, columns, rows = facets.dofmap.list, vertices.dofmap.index_map, facets.dofmap.index_map
    of_facet = np.empty((rows.size_local + rows.num_ghosts, of_cell.shape[1] - 1), dtype=np.int32)
    for facet in range(of_cell.shape[1]):
        of_facet[of_cell[:, facet]] = np.delete(vertices.dofmap.list, facet, axis=1)
    owned, d = of_facet[: rows.size_local], of_facet.shape[1]
    indices = np.sort(columns.local_to_global(owned.ravel()).reshape(owned.shape), axis=1).astype(PETSc.IntType)
    result = PETSc.Mat().createAIJ(
        [(space.size_local, space.size_global) for space in (rows, columns)],
        csr=(np.arange(len(owned) + 1, dtype=PETSc.IntType) * d, indices.ravel(), np.full(owned.size, 1 / d)),
        comm=COMM,
    )
    kept = result.createVecs()
    for keep, out in zip(kept, fixed, strict=True):
        keep.set(1.0)
        keep.array_w[out] = 0.0
    result.diagonalScale(kept[1], kept[0])
    return result


def multigrid(A: PETSc.Mat, coarse: PETSc.Mat, interpolation: PETSc.Mat) -> PETSc.KSP:
    """CG with a V-cycle: Chebyshev and Jacobi on the facets, GAMG on P1 (collective)."""
    ksp = PETSc.KSP().create(COMM)
    ksp.setOperators(A)
    ksp.setType("cg")
    ksp.setTolerances(rtol=1e-12, max_it=1000)
    pc = ksp.getPC()
    pc.setType("mg")
    pc.setMGLevels(2)
    pc.setMGInterpolation(1, interpolation)
    smoother, below = pc.getMGSmoother(1), pc.getMGCoarseSolve()
    smoother.setType("chebyshev")
    smoother.getPC().setType("jacobi")
    below.setOperators(coarse)
    below.setType("preonly")
    below.getPC().setType("gamg")
    ksp.setUp()
    return ksp


def recover(facets: fem.FunctionSpace, x: PETSc.Vec) -> fem.Function:
    """σ_h in RT0 from the Crouzeix-Raviart solution (f = 1)."""
    mesh = facets.mesh
    dim = mesh.topology.dim
    u = fem.Function(facets)
    u.x.array[: x.getLocalSize()] = x.array_r
    u.x.scatter_forward()
    Q = fem.functionspace(mesh, ("DG", 0, (dim,)))
    centroid = fem.Function(Q)
    centroid.interpolate(lambda x: x[:dim])
    V = fem.functionspace(mesh, ("RT", 1))
    sigma = fem.Function(V)
    flux = ufl.grad(u) - (ufl.SpatialCoordinate(mesh) - centroid) / dim
    sigma.interpolate(fem.Expression(flux, V.element.interpolation_points))
    return sigma
