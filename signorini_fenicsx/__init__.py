"""Fully mixed RT0/P0 methods for the Signorini problem on FEniCSx.

Start reading at :mod:`signorini_fenicsx.methods.registry` (the set rules) and :mod:`signorini_fenicsx.methods.loop`
(the one loop they share); the variational forms are in :mod:`signorini_fenicsx.forms`.
"""

import importlib.util

if importlib.util.find_spec("dolfinx_solver") is not None:
    import dolfinx_solver  # noqa: F401 - the wheel must order MPI before DOLFINx; Debian's DOLFINx has no such module

__version__ = "0.2.0"
