"""What was made of data that do not change from one problem to the next, and is kept."""

import hashlib
from collections.abc import Callable, Hashable, Sequence
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.expressions import Tree, linear_terms
from signorini_fenicsx.expressions.given import is_fixed

type AnyArray = npt.NDArray[Any]

MOST_TERMS = 8
"""Trees of more terms are always made as a whole; each term is kept."""
MOST_KEPT = 8
"""So many results of each name are kept by their arrays."""


class Kept:
    """The last few results of each name, found by all the data and arrays that they are made of.

    Steps in time and bounds ask again and again for the same ones, not only for the last.
    """

    def __init__(self) -> None:
        """Begin with nothing."""
        self._found: dict[str, dict[Hashable, Any]] = {}

    def get[T](self, comm: MPI.Comm, name: str, of: Hashable, arrays: Sequence[AnyArray], make: Callable[[], T]) -> T:
        """What `make` gives, or what of this name it gave for the same data and arrays on all ranks (collective).

        The key is made of the arrays of all ranks: what is found may depend on those of others.
        """
        found, digest = self._found.setdefault(name, {}), hashlib.blake2b(str(comm.rank).encode(), digest_size=16)
        for array in arrays:
            digest.update(np.ascontiguousarray(array))
        key = of, comm.allreduce(int.from_bytes(digest.digest()))
        found[key] = value = found.pop(key) if key in found else make()
        while len(found) > MOST_KEPT:
            found.pop(next(iter(found)))
        return cast("T", value)


class Known:
    """The last result for each name, and the data of which it was made.

    Data that are functions or UFL may change their values and stay equal, so nothing made of them is kept.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        """Begin with nothing; what is kept is the same on all ranks."""
        self._comm = comm
        self._found: dict[str, tuple[Any, Any]] = {}
        self._terms: dict[str, dict[Tree, Array]] = {}

    def get[T](self, name: str, given: Any, make: Callable[[], T]) -> T:
        """What `make` gives for these data, or what it gave if they are the same on all ranks (collective)."""
        before, value = self._found.get(name, (None, None))
        same = name in self._found and is_fixed(given) and is_fixed(before) and before == given
        if self._comm.allreduce(bool(same), MPI.LAND):
            return value
        value = make()
        self._found[name] = given, value
        return value

    def combination(self, name: str, tree: Tree, make: Callable[[Tree], Array]) -> Array:
        """What `make`, which is linear, gives for a tree; no rank waits for others in `make`.

        The first tree of a name is made as a whole. Later ones are taken apart, and only those terms are made that the
        tree before did not have: data that are in time a sum of a(t) b(x), say, are soon made no more.
        """
        if name not in self._terms:
            self._terms[name] = {}
            return make(tree)
        before, terms = self._terms[name], linear_terms(tree)
        if len(terms) > MOST_TERMS or not np.isfinite([factor for factor, _ in terms]).all():
            return make(tree)
        self._terms[name] = made = {term: before[term] if term in before else make(term) for _, term in terms}
        return np.asarray(sum(factor * made[term] for factor, term in terms))
