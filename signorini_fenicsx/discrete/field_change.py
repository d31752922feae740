"""How much σ and u change from one iterate to the next."""

import numpy as np
import ufl
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.forms.norms import l2, v_norm


class FieldChange:
    """‖σ − σ'‖_V and ‖u − u'‖_Q, with the forms compiled once."""

    def __init__(self, V: fem.FunctionSpace, Q: fem.FunctionSpace):
        """Compile for σ in V and u in Q (collective)."""
        self._comm = Q.mesh.comm
        self._sigma, self._u = fem.Function(V), fem.Function(Q)
        self._norms = [fenicsx.form(v_norm(self._sigma, ufl.dx)), fenicsx.form(l2(self._u, ufl.dx))]

    def __call__(self, iterate: Iterate, before: Iterate) -> tuple[float, float]:
        """The norms (collective)."""
        self._sigma.x.array[:] = iterate.sigma.x.array - before.sigma.x.array
        self._u.x.array[:] = iterate.u.x.array - before.u.x.array
        local = np.array([fem.assemble_scalar(form) for form in self._norms])
        sigma, u = np.sqrt(self._comm.allreduce(local)).tolist()
        return sigma, u
