"""The memory that a run needs, and the memory that there is: what does not fit is refused before it is meshed."""

import re
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError

FACETS_PER_CELL: Mapping[int, float] = {2: 1.5, 3: 2.0}
PROCESS_BYTES = 180 * 2**20
"""Memory of a rank without a mesh."""
BYTES_PER_FACET: Mapping[int, float] = {2: 830.0, 3: 940.0}
"""For alg1 to alg4 with the hybrid backend, certificate and output included; measured on at least 395 000 facets. Other
methods need more."""


def check_memory(comm: MPI.Comm, what: str, dim: int, cells: float, h: float | None = None) -> None:
    """Refuse a mesh on which no problem can be solved with the memory that there is (collective).

    The ranks of a machine share its memory, and the cells are shared out evenly.

    Args:
        comm: Communicator.
        what: Name of the mesh.
        dim: Its dimension.
        cells: Its number of cells, about.
        h: Its largest cell diameter, if another one may be chosen.

    Raises:
        InputError: On all ranks, with the size that would fit.
    """
    neighbours = comm.Split_type(MPI.COMM_TYPE_SHARED)
    memory = comm.allreduce(available() * comm.size / neighbours.size, MPI.MIN)
    neighbours.Free()
    needed = BYTES_PER_FACET[dim] * FACETS_PER_CELL[dim] * cells
    if needed > memory:
        fit = cells * memory / needed
        larger = 1.05 * (cells / fit) ** (1 / dim)  # with some reserve, as it is rounded to two digits
        advice = "take a coarser mesh or more machines" if h is None else f"h = {h * larger:.2g} fits"
        raise InputError(
            f"{what}: about {cells:.2g} cells need {needed / 2**30:.3g} GB of memory, and {memory / 2**30:.3g} GB are "
            f"there, enough for {fit:.2g} cells; {advice}"
        )


def available(system: Path = Path("/")) -> float:
    """Bytes that the processes of this machine can still get: the least of what is free and what limits allow.

    Args:
        system: The root of the file system.
    """
    entry = re.search(r"^MemAvailable:\s*(\d+) kB", _text(system / "proc/meminfo"), re.MULTILINE)
    left = [1024.0 * int(entry[1])] if entry else [float("inf")]
    groups = re.findall(r"^\d+:([^:\n]*):(.*)$", _text(system / "proc/self/cgroup"), re.MULTILINE)
    for controllers, name in groups:
        if controllers == "":
            root, files = system / "sys/fs/cgroup", ("memory.max", "memory.current")
        elif "memory" in controllers.split(","):  # the first version of control groups
            root, files = system / "sys/fs/cgroup/memory", ("memory.limit_in_bytes", "memory.usage_in_bytes")
        else:
            continue
        path = PurePosixPath(name.lstrip("/"))
        left += [_left(root / group, *files) for group in (path, *path.parents)]
    return max(0.0, min(left))


def _left(group: Path, limit: str, usage: str) -> float:
    """What a control group may still take; files that are in memory only to be faster count as free."""
    most, used = _text(group / limit), _text(group / usage)
    if not most.isdecimal() or not used.isdecimal():  # "max", or no such group
        return float("inf")
    spare = re.search(r"^(?:total_)?inactive_file (\d+)", _text(group / "memory.stat"), re.MULTILINE)
    return float(int(most) - int(used) + (int(spare[1]) if spare else 0))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:
        return ""
