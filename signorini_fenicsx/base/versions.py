"""Versions of the software that computed a result."""

import platform
from importlib.metadata import version

import dolfinx
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.version import __version__


def versions() -> dict[str, str]:
    """Versions of everything that can change a result."""
    petsc = ".".join(str(number) for number in PETSc.Sys.getVersion())
    return {
        "signorini_fenicsx": __version__,
        "dolfinx": dolfinx.__version__,
        "petsc": petsc,
        "gmsh": version("gmsh"),
        "mpi": MPI.Get_library_version().splitlines()[0].strip("\0 "),
        "python": platform.python_version(),
    }
