"""Quantities of beds, whose discrete solutions are exact."""

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.quantities import Energy, Integral, Quantity
from signorini_fenicsx.quantities.of_solution import Quantities


def _check(domain, posed, kind):
    if not isinstance(kind, Energy | Integral):
        raise InputError(f"{type(kind).__name__}: a bed has Integral and Energy")


def _exactly(solution, densities):
    total = float(solution.spaces.mesh.comm.allreduce(solution.spaces.cell_measures @ densities))
    return Quantity(total, total, total, True)


def _energy(solution):
    u = solution.u.x.array
    return _exactly(solution, solution.problem.k * u**2 / 2 - solution.data * u)


class _Integrals:
    def __init__(self, solution, kind):
        self.solution = solution

    def interval(self, near=None):
        return _exactly(self.solution, self.solution.u.x.array)


QUANTITIES = Quantities(_check, _energy, _Integrals, _Integrals, lambda solution: "")
