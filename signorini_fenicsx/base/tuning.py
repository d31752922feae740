"""Sizes from which the program works differently. They change the cost of a run, not its results."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True)
class Tuning:
    """Sizes that were measured to be fast.

    Attributes:
        direct_up_to: Systems with at most this many unknowns are factorised where that is faster or CG fails; larger
            ones are solved by CG with multigrid. None for what is fast in the physics, its `DIRECT_UP_TO`.
        predict_from: From this number of unknowns on the sets are predicted; on smaller meshes a cold start is as fast.
            None for what is fast in the physics, its `PREDICT_FROM`.
        coarsening: Mesh size of the coarser mesh of a prediction, divided by that of the finer mesh.
        coarsen_from: From this number of facets on the sets are predicted on a coarser mesh first; on smaller meshes
            that costs more than it saves.
        predict_in_cells_from: The same where there are laws in Ω, whose sets of cells move by one cell per step.
        patience: A solve stops early if the sets that its iterates ask for are steady for this many iterations of the
            linear solver.
        leeway: The sets count as steady if at most this share of the sites that want to change still varies. Where many
            sites change, the next solve decides about the rest.
        layers: For each dimension, number of cells between a site that changes and the edge of its patch.
        patch_share: A patch with at most this share of all unknowns costs little compared with a step of the solver.
        patch_steps: Largest number of set updates on a patch; sets that change for longer leave the patch.
        one_table_up_to: Largest number of facets of Γ_S whose table is one text file; of more each rank writes its own.
        on_one_rank_up_to: Largest number of cells for what one rank does with the whole mesh: the methods
            psor and qp. More are refused.
        dense_up_to: Largest number of facets of Γ_S for dense matrices on one rank, which the H^{1/2} norm needs; their
            square root takes a minute. More are refused.
    """

    direct_up_to: int | None = None
    predict_from: int | None = None
    coarsening: float = 4.0
    coarsen_from: int = 30_000
    predict_in_cells_from: int = 300
    patience: int = 2
    leeway: float = 0.02
    layers: Mapping[int, int] = MappingProxyType({2: 32, 3: 4})
    patch_share: float = 0.02
    patch_steps: int = 10
    one_table_up_to: int = 1_000_000
    on_one_rank_up_to: int = 2_000_000
    dense_up_to: int = 5_000

    def is_large(self, unknowns: int, direct_up_to: int) -> bool:
        """Whether a system is too large to be factorised; in a physics where this size is fast."""
        return unknowns > (direct_up_to if self.direct_up_to is None else self.direct_up_to)

    def predicts(self, unknowns: int, predict_from: int) -> bool:
        """Whether a system is so large that its sets are predicted; in a physics where this size is fast."""
        return unknowns >= (predict_from if self.predict_from is None else self.predict_from)
