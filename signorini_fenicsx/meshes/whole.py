"""Meshes that rank 0 has whole: those of all ranks gathered there, and one handed out to them."""

from collections.abc import Collection, Mapping, Sequence

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, rows_of
from signorini_fenicsx.base.errors import InputError, check_names
from signorini_fenicsx.base.owned import cell_nodes, number_of_cells, original_cells
from signorini_fenicsx.base.parallel import gather_rows, on_root
from signorini_fenicsx.meshes.checks import FileMesh, faces
from signorini_fenicsx.meshes.domain import AXES, Domain, axis_part, brought_together, distribute, in_regions, marked

type Entities = npt.NDArray[np.int32]

OWN_CURVATURE = 8.0
"""`Domain.curvature` of a domain of size 1 from a file, on the assumption that radii are at least 1/64."""


def check_pairs(pairs: Sequence[Sequence[str]], parts: Collection[str]) -> None:
    """Refuse what is no list of the parts of pairs.

    Raises:
        InputError: If it is none, or a part is unknown.
    """
    for names in pairs:
        check_names("pairs", names)
        if unknown := [part for part in names if part not in parts]:
            raise InputError(f"pairs: unknown part '{unknown[0]}'; there are {', '.join(parts)}")


def gathered(
    mesh: dolfinx.mesh.Mesh, parts: Mapping[str, Entities], regions: Mapping[str, Entities]
) -> FileMesh | None:
    """The whole mesh on rank 0 in the order in which it was made; None elsewhere (collective)."""
    dim, comm, nodes = mesh.topology.dim, mesh.comm, mesh.geometry.index_map()

    def numbers(local: Entities) -> Indices:
        return nodes.local_to_global(local.ravel().astype(np.int32)).reshape(local.shape)

    facets = {
        name: numbers(dolfinx.mesh.entities_to_geometry(mesh, dim - 1, chosen)).reshape(-1, dim)
        for name, chosen in parts.items()
    }
    points = gather_rows(comm, mesh.geometry.x[: nodes.size_local, :dim])
    made = gather_rows(comm, mesh.geometry.input_global_indices[: nodes.size_local])
    cells, cells_made = gather_rows(comm, numbers(cell_nodes(mesh))), gather_rows(comm, original_cells(mesh))
    rows = gather_rows(comm, in_regions(regions, number_of_cells(mesh)))
    of_parts = {name: gather_rows(comm, chosen) for name, chosen in facets.items()}
    if points is None or made is None or cells is None or rows is None or cells_made is None:
        return None
    number, order = np.argsort(np.argsort(made)), np.argsort(cells_made)
    return FileMesh(
        points=points[np.argsort(made)],
        cells=number[cells[order]],
        parts={
            name: np.unique(np.sort(number[chosen], axis=1), axis=0)
            for name, chosen in of_parts.items()
            if chosen is not None
        },
        regions={name: np.flatnonzero(rows[order, column]) for column, name in enumerate(regions)},
    )


def handed_out(
    comm: MPI.Comm, whole: FileMesh | None, name: str, made: str = "given", pairs: Sequence[Sequence[str]] = ()
) -> Domain:
    """The domain of a mesh that rank 0 has, distributed (collective).

    Args:
        comm: Communicator of the domain.
        whole: The mesh; None on other ranks.
        name: Name of the domain.
        made: How the mesh was made, in words.
        pairs: The parts of each pair of surfaces, see `Domain.together`.
    """

    def about() -> tuple[int, dict[str, str], tuple[str, ...], float, bool]:
        assert whole is not None
        labels = {part: AXES[_longest_axis(whole.points[facets])] for part, facets in whole.parts.items()}
        size = float(np.ptp(whole.points, axis=0).max())
        return whole.dim, labels, tuple(whole.regions), OWN_CURVATURE / size, whole.together is not None

    dim, labels, regions, curvature, is_cut = on_root(comm, about)
    points, cells = np.empty((0, dim)), np.empty((0, dim + 1), dtype=np.int64)
    facets: Mapping[str, Indices] = {part: np.empty((0, dim), dtype=np.int64) for part in labels}
    inside, together = None, np.empty((0, 2), dtype=np.int64) if is_cut or pairs else None
    if whole is not None:
        points, cells, facets = whole.points, whole.cells, whole.parts
        together = _together(whole, pairs)
        inside = in_regions(whole.regions, len(cells))
    parts = {part: axis_part(label) for part, label in labels.items()}
    mesh = distribute(comm, points, cells, dim, together=together)
    there, together_in_pairs = marked(mesh, facets, inside, regions), tuple(map(tuple, pairs))
    return Domain(parts=parts, curvature=curvature, name=name, made=made, together=together_in_pairs, **there)


def _together(whole: FileMesh, pairs: Sequence[Sequence[str]]) -> Indices | None:
    """Pairs of cells that get to one rank: at cuts, and at both sides of pairs of surfaces (rank 0)."""
    if not pairs:
        return whole.together
    everything = faces(whole.cells)
    at_pairs = [rows_of(np.concatenate([whole.parts[part] for part in names]), everything) for names in pairs]
    found = brought_together(MPI.COMM_SELF, [rows % len(whole.cells) for rows in at_pairs])
    return found if whole.together is None else np.concatenate([whole.together, found])


def _longest_axis(points: Array) -> int:
    return int(np.argmax(np.ptp(points.reshape(-1, points.shape[-1]), axis=0))) if points.size else 0
