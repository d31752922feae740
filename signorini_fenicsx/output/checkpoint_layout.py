"""The arrays of a checkpoint."""

import numpy as np

LAYOUT: dict[str, tuple[type, *tuple[str, ...]]] = {
    "points": (np.float64, "points", "dim"),
    "cells": (np.int64, "cells", "corners"),
    "u": (np.float64, "cells"),
    "sigma": (np.float64, "cells", "dim"),
    "divergence": (np.float64, "cells"),
    "facet_part": (np.int64, "facets"),
    "facet_x": (np.float64, "facets", "space"),
    "facet_along": (np.float64, "facets"),
    "facet_measure": (np.float64, "facets"),
    "facet_u": (np.float64, "facets"),
    "facet_p": (np.float64, "facets"),
    "facet_flux": (np.float64, "facets"),
    "facet_condition": (np.int64, "facets"),
    "facet_vertices": (np.int64, "facets", "dim"),
}
"""Type and shape of the arrays of a file; a word stands for the same number everywhere."""
STEP_LAYOUT: dict[str, tuple[type, *tuple[str, ...]]] = {"memory": (np.float64, "cells")}
"""What is added for a step of a problem in time: what it takes from the steps before, as a load."""
ELASTIC_LAYOUT: dict[str, tuple[type, *tuple[str, ...]]] = {
    "points": (np.float64, "points", "dim"),
    "cells": (np.int64, "cells", "corners"),
    "u": (np.float64, "cells", "corners", "dim"),
    "sigma": (np.float64, "cells", "corners", "corners", "dim", "dim"),
    "facet_p": (np.float64, "facets", "dim"),
    "facet_condition": (np.int64, "facets", "dim"),
    "facet_slip": (np.float64, "facets", "dim"),
    "facet_state": (np.int64, "facets", "dim"),
    "facet_bound": (np.float64, "facets", "dim"),
    "facet_vertices": (np.int64, "facets", "dim"),
}
"""The same for elastic solutions: values at vertices in ascending order."""
VALUES = ("u", "sigma", "divergence", "facet_u", "facet_p", "facet_flux", "facet_slip", "facet_bound")
"""Arrays that need not be finite if the run has failed."""
