"""How beds are kept in files."""

import numpy as np
from dolfinx import fem

from signorini_fenicsx.solving.kept import Keeping
from springs.solving import Bed, Edges, Rested, residuals, state


def _read(problem, spaces, stored):
    u = fem.Function(spaces.Q, name="u")
    u.x.array[:] = stored.in_cells(spaces, "u")
    load = stored.in_cells(spaces, "load")
    outcome, kkt = stored.outcome(*state(spaces, u)), residuals(problem, u, load)
    return Rested(
        spaces=spaces,
        data=load,
        outcome=outcome,
        kkt=kkt,
        **stored.about,
    )


KEEPING = Keeping(
    boundary=Edges,
    problem=Bed,
    laws={},
    layout={"u": (np.float64, "cells"), "load": (np.float64, "cells")},
    codes={},
    in_cells=lambda solution: {"u": solution.u.x.array, "load": solution.data},
    on_facets=lambda solution: {"vertices": solution.table().vertices},
    read=_read,
)
