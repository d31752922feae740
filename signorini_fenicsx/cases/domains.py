"""The domain of a case."""

from mpi4py import MPI

from signorini_fenicsx.base.parallel import collect_garbage
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain, estimated_cells, own_domain


def mesh_case(case: CaseFile, comm: MPI.Comm) -> Domain:
    """Mesh the domain of a case, or read its mesh (collective).

    Raises:
        InputError: If there is no mesh with the h of the case, or the mesh of the file does not fit the case.
    """
    geometry = case.geometry
    if geometry.shape is not None:
        return build_domain(comm, geometry.shape, case.solve.h, mesh=geometry.mesh, diagonal=geometry.diagonal)
    pairs = [[*pair.slave, *pair.master] for pair in getattr(case, "pair", ())]
    domain = own_domain(comm, geometry.source, case.file_h, case.parts.named, case.sides, pairs)
    case.check_dimension(domain.mesh.topology.dim)
    return domain


class LastMesh:
    """A maker of meshes like `mesh_case` that keeps the last one: all its forms are there for the next case on it."""

    def __init__(self) -> None:
        self._key: object = None
        self._domain: Domain | None = None

    def __call__(self, case: CaseFile, comm: MPI.Comm) -> Domain:
        """The mesh of a case (collective).

        Raises:
            InputError: As `mesh_case`.
        """
        parts = case.parts.named, case.sides, [(pair.slave, pair.master) for pair in getattr(case, "pair", ())]
        key = comm, case.geometry, case.solve.h, None if case.geometry.shape is not None else parts
        if self._domain is None or key != self._key:
            self.forget()
            collect_garbage(comm)  # the old mesh before the new one takes memory
            self._key, self._domain = key, mesh_case(case, comm)
        return self._domain

    def forget(self) -> None:
        """Drop the mesh."""
        self._key = self._domain = None


def rough_cells(case: CaseFile) -> float:
    """Rough number of cells of the mesh of a case. The mesh is not made, but a file is read (rank 0).

    Raises:
        InputError: If the file or its mesh cannot be used, or there are too many.
    """
    geometry = case.geometry
    if geometry.shape is not None:
        return estimated_cells(geometry.shape, case.solve.h)
    return geometry.source.size(case.file_h)[1]
