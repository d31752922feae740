"""Sizes at which the program changes its ways. They change what a run costs, not what it finds."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True)
class Tuning:
    """What was measured to be fast.

    Attributes:
        direct_up_to: Facets up to which a direct factorisation takes tenths of a second, whatever κ and the cells are
            like; larger facet systems go to CG with multigrid.
        predict_from: Facets of the mesh from which the sets are predicted; below, a cold start takes tenths of a
            second.
        coarsening: Mesh size of the coarser mesh of a prediction, in multiples of the finer one's.
        coarsen_from: Facets of a coarser mesh from which it gets a prediction itself; below, its own coarser mesh costs
            more than it saves.
        patience: Iterations of the linear solver over which the sets that it asks for must stand still.
        leeway: Share of the sites that want to change whose condition need not stand still: where many change, the
            next solve decides about them.
        layers: Cells, by dimension, between a site that changes and the edge of the patch on which the sets then
            settle.
        patch_share: Share of all unknowns up to which a patch costs little beside a step of the solver.
        patch_steps: Set updates on a patch at most; sets that move for longer leave the patch.
    """

    direct_up_to: int = 60_000
    predict_from: int = 60_000
    coarsening: float = 4.0
    coarsen_from: int = 30_000
    patience: int = 2
    leeway: float = 0.05
    layers: Mapping[int, int] = MappingProxyType({2: 32, 3: 4})
    patch_share: float = 0.02
    patch_steps: int = 10
