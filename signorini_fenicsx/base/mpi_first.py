"""The import order that the wheel `dolfinx-solver-real` needs, wherever DOLFINx is imported.

The wheel needs `dolfinx_solver`, which loads MPI, before DOLFINx, PETSc and Basix. Debian's DOLFINx has no such module.
"""

import sys

FIRST = "dolfinx_solver"
LATER = ("basix", "dolfinx", "petsc4py", "slepc4py")


class _MpiFirst:
    """A finder that finds no module, but imports `dolfinx_solver` when the first of the others is imported."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        """Import `dolfinx_solver` once."""
        if name in LATER:
            sys.meta_path.remove(self)
            try:
                __import__(FIRST)
            except ModuleNotFoundError as error:
                if error.name != FIRST:
                    raise


def keep_order() -> None:
    """Have every import of DOLFINx preceded by that of `dolfinx_solver`, if it exists; this costs nothing before."""
    if FIRST not in sys.modules and not any(isinstance(finder, _MpiFirst) for finder in sys.meta_path):
        sys.meta_path.insert(0, _MpiFirst())
