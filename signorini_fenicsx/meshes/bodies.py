"""Domains of several bodies with meshes of their own, which share no nodes: files, named shapes, other domains.

A part of a body is called `body.part`. Its cells are the region `body`, or where its mesh has several regions these
are called `body.region`. The whole mesh is made on rank 0, and handed out then.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.base.errors import InputError, check_kind, telling
from signorini_fenicsx.base.parallel import collector_off, on_root
from signorini_fenicsx.meshes.checks import FileMesh
from signorini_fenicsx.meshes.domain import Domain, other_side
from signorini_fenicsx.meshes.files import Sizes, is_geometry, read_mesh_file
from signorini_fenicsx.meshes.meshing import (
    allowed,
    build_domain,
    estimated_cells,
    expected_size,
    own_size,
)
from signorini_fenicsx.meshes.named_faces import Rule, named
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.meshes.uniform import refined_uniformly
from signorini_fenicsx.meshes.whole import check_pairs, gathered, handed_out

SAME = 1e-9
"""Sizes that differ by less than this share are equal."""


@dataclass(frozen=True)
class Body:
    """A body: a named shape, or a file, and where it is.

    Attributes:
        shape: Name of the shape; None for a file.
        file: Path of the file.
        offset: By how much it is moved; nothing for 0.
        h: Its largest cell diameter; None for that of a file, or of the whole domain.
        mesh: How a shape is meshed, see `build_domain`.
        diagonal: See there.
        faces: Names for faces of a file, see `named_faces`.
        sizes: Sizes of cells at parts or regions of a geometry, see `read_mesh_file`.
    """

    shape: str | None = None
    file: str | None = None
    offset: tuple[float, ...] = ()
    h: float | None = None
    mesh: str = "unstructured"
    diagonal: str | None = None
    faces: Mapping[str, Rule] = MappingProxyType({})
    sizes: Sizes = ()

    @property
    def is_fixed(self) -> bool:
        """Whether its mesh can be made finer only by refinement: it is a mesh file."""
        return self.shape is None and not is_geometry(self.file or "")

    def usual(self) -> float | None:
        """The largest cell diameter that it asks for, or that its file has; None if there is none (rank 0)."""
        return self.h or (None if self.file is None else own_size(self.file, self.sizes).h)

    def size(self, h: float | None) -> tuple[int, float]:
        """Dimension and number of cells with this h (rank 0).

        Raises:
            InputError: If there are more than MAX_CELLS, or the cells of a mesh file are smaller.
        """
        if self.shape is not None:
            return shape_of(self.shape).dim, estimated_cells(self.shape, h or 1.0)
        if not self.is_fixed:
            return expected_size(self.file or "", h, self.sizes)
        own = own_size(self.file or "")
        levels = math.ceil(math.log2(own.h / (h or own.h)) - SAME)
        if levels < 0:
            raise InputError(
                f"h = {h:.4g}: a mesh file can be refined only, and the cells of this one have {own.h:.4g}"
            )
        return own.dim, allowed(own.cells * 2.0 ** (own.dim * levels), h or own.h, self.file or "")

    def meshed(self, h: float | None) -> FileMesh:
        """The mesh of the body with this h, moved to its place (rank 0)."""
        changed = ""
        if self.shape is not None:
            domain = build_domain(MPI.COMM_SELF, self.shape, h or 1.0, mesh=self.mesh, diagonal=self.diagonal)
        else:
            if h is not None:
                self.size(h)  # refuses too large a size
            path = self.file or ""
            read = named(read_mesh_file(path, None if self.is_fixed else h, sizes=self.sizes), self.faces, path)
            domain, changed = handed_out(MPI.COMM_SELF, read, path), read.changed
            while self.is_fixed and h is not None and domain.h > h * (1 + SAME):
                domain = refined_uniformly(domain)
        mesh = gathered(domain.mesh, domain.facets, domain.regions)
        assert mesh is not None
        if self.offset and len(self.offset) != mesh.dim:
            raise InputError(f"offset: must have {mesh.dim} numbers, not {len(self.offset)}")
        return replace(mesh, points=mesh.points + np.array(self.offset or 0.0), changed=changed)


@dataclass(frozen=True)
class Bodies:
    """Bodies by their names, as the source of one mesh, see `meshing.Source`.

    A largest cell diameter h of all of them keeps the ratios of those that they have: the coarsest gets h. A mesh file
    is refined uniformly for it.
    """

    bodies: Mapping[str, Body]
    made = "bodies"

    @property
    def name(self) -> str:
        """See `Source`."""
        return ", ".join(self.bodies)

    @property
    def words(self) -> str:
        """See `Source`."""
        return f"bodies {self.name}"

    def size(self, h: float | None) -> tuple[int, float]:
        """See `Source`."""
        dims, cells = zip(*self._of_each(Body.size, h).values(), strict=True)
        return dims[0], allowed(sum(cells), h or 1.0, self.words)

    def read(self, h: float | None) -> tuple[FileMesh, int]:
        """See `Source`."""
        return _joined(self._of_each(Body.meshed, h)), 0

    def _of_each[T](self, found: Callable[[Body, float | None], T], h: float | None) -> dict[str, T]:
        """What is found of each body with its part of h (rank 0).

        Raises:
            InputError: With the name of the body, if `found` raises it.
        """
        of_bodies = {}
        for name, body in self.bodies.items():
            with telling(f"[geometry] bodies.{name}"):
                of_bodies[name] = found(body, body.h if h is None else self._shrunk(body, h))
        return of_bodies

    def _shrunk(self, body: Body, h: float) -> float:
        """The h of a body where the coarsest one gets this h (rank 0)."""
        usual = body.usual()
        return h if usual is None else usual * h / max(filter(None, map(Body.usual, self.bodies.values())))


@collector_off()
def domain_of_bodies(bodies: Mapping[str, Domain], *, pairs: Sequence[Sequence[str]] = ()) -> Domain:
    """One domain of several that share nothing, as bodies with meshes of their own (collective).

    A part of a body is called `body.part`; its cells are the region `body`, or `body.region` where it has several. The
    new mesh is made on rank 0 and handed out; UFL data must be written on it.

    Args:
        bodies: The domains by the names of their bodies, all in the plane or all in space.
        pairs: The names of the parts on both sides of each `Pair`, such as [["up.bottom", "low.top"]], whose cells get
            to one rank: only there its error has a bound.

    Raises:
        InputError: If a name has a dot, a domain is cut along an inner part, or there is no part of a pair.
    """
    check_kind("bodies", bodies, Mapping, hint='; an example is {"up": domain, "low": domain_of(…)}')
    meshes: dict[str, FileMesh | None] = {}
    for name, domain in bodies.items():
        check_kind(f"bodies['{name}']", domain, Domain)
        check_name(name)
        if cut := [part for part in domain.parts if other_side(part) in domain.parts]:
            raise InputError(f"bodies['{name}']: is cut along '{cut[0]}'; a body has no inner part")
        meshes[name] = gathered(domain.mesh, domain.facets, domain.regions)
    if not meshes:
        raise InputError("bodies: must not be empty")
    comm = next(iter(bodies.values())).mesh.comm
    whole = list[FileMesh]()
    on_root(comm, lambda: whole.append(_joined({name: mesh for name, mesh in meshes.items() if mesh is not None})))
    check_pairs(pairs, [f"{name}.{part}" for name, domain in bodies.items() for part in domain.parts])
    return handed_out(comm, whole[0] if whole else None, ", ".join(bodies), "bodies", pairs)


def check_name(name: str) -> None:
    """Refuse what cannot be in front of the dot of `body.part`.

    Raises:
        InputError: If this is no name of a body.
    """
    if not re.fullmatch(r"\w+", name):
        raise InputError(f"'{name}' is no name of a body; a name has letters, digits and underscores only")


def _joined(meshes: Mapping[str, FileMesh]) -> FileMesh:
    """One mesh of those of the bodies by their names, with the names of their parts and regions.

    Raises:
        InputError: If some are in the plane and others in space.
    """
    names, several = list(meshes), list(meshes.values())
    flat = next((name for name in names if meshes[name].dim != several[0].dim), None)
    if flat is not None:
        raise InputError(
            f"[geometry] bodies: '{names[0]}' has {several[0].dim} dimensions, and '{flat}' has {meshes[flat].dim}"
        )
    parts, regions = dict[str, Indices](), dict[str, Indices]()
    points = np.cumsum([0, *(len(mesh.points) for mesh in several)])
    cells = np.cumsum([0, *(len(mesh.cells) for mesh in several)])
    for name, mesh, point, cell in zip(names, several, points, cells, strict=False):
        parts |= {f"{name}.{part}": facets + point for part, facets in mesh.parts.items()}
        within = mesh.regions if len(mesh.regions) > 1 else {"": np.arange(len(mesh.cells))}
        regions |= {f"{name}.{region}".removesuffix("."): rows + cell for region, rows in within.items()}
    return FileMesh(
        np.concatenate([mesh.points for mesh in several]),
        np.concatenate([mesh.cells + point for mesh, point in zip(several, points, strict=False)]),
        parts,
        regions,
        changed="; ".join(mesh.changed for mesh in several if mesh.changed),
    )
