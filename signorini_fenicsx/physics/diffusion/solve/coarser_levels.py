"""Levels of multigrid for P1 on a mesh that was refined uniformly: P1 on the meshes from which it was made.

GAMG is what is left on the coarsest of them. The operators between are Galerkin's, so levels need neither data nor
conditions of their own. GAMG's own levels from the finest mesh on take longer to set up for each set and give more
iterations.
"""

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.linear.two_level import choose_smoother
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.uniform import parents


def use_coarser_meshes(pc: PETSc.PC, space: fem.FunctionSpace, domain: Domain) -> None:
    """Make `pc`, on P1, a multigrid on the meshes from which the domain's was refined, or else GAMG (collective).

    Args:
        pc: The preconditioner. Its option pc_mg_galerkin must be "both".
        space: P1 on the domain's mesh.
        domain: The domain.
    """
    steps = _interpolations(space, domain)
    if not steps:
        pc.setType("gamg")
        return
    pc.setType("mg")
    pc.setMGLevels(len(steps) + 1)
    for level, step in enumerate(reversed(steps), start=1):
        pc.setMGInterpolation(level, step)
        choose_smoother(pc, level, domain.mesh.topology.dim)
    coarsest = pc.getMGCoarseSolve()
    coarsest.setType("preonly")
    coarsest.getPC().setType("gamg")


def _interpolations(space: fem.FunctionSpace, domain: Domain) -> list[PETSc.Mat]:
    """Interpolations from each mesh to the next finer one, the finest first (collective).

    Unknowns are numbered by `space` on the finest mesh, and as the nodes of the other meshes are.
    """
    number = space.dofmap.index_map.size_local
    of_unknown = np.empty(number + space.dofmap.index_map.num_ghosts, dtype=np.int64)
    of_unknown[space.dofmap.list] = domain.mesh.geometry.dofmaps[0]
    rows, steps = of_unknown[:number], []
    while domain.coarser is not None:
        steps.append(_means(parents(domain)[rows], domain.coarser))
        domain = domain.coarser
        rows = np.arange(domain.mesh.geometry.index_map().size_local)
    return steps


def _means(pairs: Indices, coarse: Domain) -> PETSc.Mat:
    """The means of pairs of nodes of a mesh, or one value where both are the same (collective)."""
    nodes = coarse.mesh.geometry.index_map()
    columns = np.sort(nodes.local_to_global(pairs.ravel().astype(np.int32)).reshape(pairs.shape), axis=1)
    used = np.ones(pairs.shape, dtype=bool)
    used[:, 1] = columns[:, 0] != columns[:, 1]
    count = used.sum(axis=1)
    begins = np.concatenate([[0], np.cumsum(count)])
    return PETSc.Mat().createAIJ(
        [(len(pairs), PETSc.DETERMINE), (nodes.size_local, nodes.size_global)],
        csr=(begins.astype(PETSc.IntType), columns[used].astype(PETSc.IntType), np.repeat(1 / count, count)),
        comm=coarse.mesh.comm,
    )
