"""What the solutions of all physics have in common."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.contact.residuals import Residuals
from signorini_fenicsx.discrete.contact_sets import FacetSet
from signorini_fenicsx.discrete.curved import of_polygon
from signorini_fenicsx.discrete.sections import Profile, Spots, Through
from signorini_fenicsx.discrete.site_table import SiteTable, Surfaces
from signorini_fenicsx.meshes.domain import AXES, Domain
from signorini_fenicsx.meshes.sampling import at_points
from signorini_fenicsx.methods.registry import Method
from signorini_fenicsx.solving.fields import Fields
from signorini_fenicsx.solving.options import Options

IN_SUMMARY = 20
"""Most points that are in summaries; all are in tables."""

type Columns = Mapping[str, npt.NDArray]
"""The columns of a table by their names."""


class InContact(NamedTuple):
    """How much is in contact.

    Attributes:
        facets: Number of facets in contact; of elastic ones those with a vertex in contact.
        measure: The measure of the contact; of elastic facets the share of the vertices in contact.
    """

    facets: int
    measure: float


class PointValues(NamedTuple):
    """A solution at points.

    Attributes:
        u: `Solved.potential`, shape (n,); a displacement has shape (n, dim).
        sigma: σ_h, shape (n, dim); a stress has shape (n, dim, dim).
    """

    u: Array
    sigma: Array


@dataclass(frozen=True, repr=False, kw_only=True)
class Solved(ABC):
    """A problem with the way it was solved and what came out; subclasses have types for these fields, and more.

    Attributes:
        name: Name of the results.
        title: A longer name in words.
        problem: The data as given.
        options: Algorithm, backend and their parameters.
        spaces: The discrete spaces; `spaces.mesh` is the mesh.
        outcome: How the method ended, with σ_h and u_h; it has converged if the residuals are small as well.
        kkt: Residuals of the discrete problem.
        source: What the problem was read from; None if it was given in Python.
        data: The data on the mesh; None where they are nothing but numbers.
        step: Number of the step of a problem in time, from 1; None for others.
        system: What has solved it, as long as that is alive; its factors serve derivatives. None if it is not known.
        timings: Seconds per phase, the longest over all ranks.
        peak_memory: Peak memory of the processes so far in bytes, summed over ranks.
    """

    name: str
    title: str
    problem: Any
    options: Options
    spaces: Any
    outcome: Outcome
    kkt: Residuals
    source: object = None
    data: Any = None
    step: int | None = None
    system: Callable[[], Any] | None = field(default=None, compare=False)
    timings: dict[str, float] = field(default_factory=dict)
    peak_memory: int = 0

    WORD: ClassVar[str] = "Solution"
    offers: ClassVar[Sequence[str]] = (
        *("approach", "at", "boundary", "certify", "contact", "converged", "derivative", "errors", "gradient"),
        *("kkt", "name", "norms", "options", "outcome", "plot", "potential", "probe", "problem", "quantity"),
        *("segments_of_parts", "sigma", "spaces", "step", "summary", "through_section", "title", "u", "write"),
    )
    """The names that completion in a notebook shows; others are for the program itself."""
    order: ClassVar[int]
    """Order in h of ‖σ − σ_h‖ for a smooth u."""
    unit_keys: ClassVar[tuple[str, str]] = ("unit", "flux_unit")
    """The keys of `[plot]` for the units of u and σ."""

    @property
    def best_rate(self) -> float:
        """The best possible slope of the error against the number of unknowns."""
        return -self.order / self.u.function_space.mesh.topology.dim

    @property
    def sigma(self) -> fem.Function:
        """σ_h: the flux in RT0, or the symmetric stress, linear on each subcell."""
        return self.outcome.iterate.sigma

    @property
    def u(self) -> fem.Function:
        """u_h: a constant per cell, or a linear displacement."""
        return self.outcome.iterate.u

    @property
    def potential(self) -> fem.Function:
        """What is known best of u at points; for most physics u_h (collective when first used)."""
        return self.u

    @property
    def converged(self) -> bool:
        """Whether the sets repeated and all residuals are small."""
        return self.outcome.converged

    @property
    def method(self) -> Method:
        """The method that solved it."""
        return self.options.method

    @property
    def approach(self) -> str:
        """The problem and its method, in words."""
        return self.method.title

    @property
    def after(self) -> str:
        """What a step has from those before, in words that go on a sentence; empty for nothing."""
        return ", with the computed earlier steps"

    @property
    def boundary(self) -> Any:
        """The parts of each kind of boundary."""
        return self.problem.boundary

    @property
    def physics(self) -> str:
        """Name of the physics."""
        physics: str = self.boundary.physics
        return physics

    @property
    def gamma(self) -> str:
        """What the boundary in contact is called: Γ with the first letter of its key."""
        return f"Γ_{next(iter(self.boundary.named))[0].upper()}"

    @property
    def contact_parts(self) -> Sequence[str]:
        """The parts in contact."""
        return next(iter(self.boundary.named.values()))

    @property
    def touching(self) -> Mask:
        """Mask of the facets in contact, or of their vertices, shape (facets, d)."""
        return self.contact_set().inside

    @cached_property
    def contact(self) -> InContact:
        """How many facets are in contact, and the measure of `touching` (collective when first used)."""
        facets, _, measure = self._touched
        return InContact(facets, measure)

    def sites_in_contact(self) -> tuple[int, float]:
        """Number of sites in contact, and their measure: of facets, of cells under an obstacle, of facet vertices."""
        _, sites, measure = self._touched
        return sites, measure

    @cached_property
    def _touched(self) -> tuple[int, int, float]:
        """Numbers of facets and of `touching`, and the measure of the latter (collective when first used)."""
        (kind, *_), touching = self.spaces.site_kinds, self.touching
        measure = kind.measure[touching.ravel()].sum()
        local = np.array([self.contact_set().inside.sum(), touching.sum(), measure])
        facets, sites, measure = self.spaces.mesh.comm.allreduce(local).tolist()
        return int(facets), int(sites), measure

    @abstractmethod
    def contact_set(self) -> FacetSet:
        """The facets in contact."""

    @collector_off()
    def at(self, points: npt.ArrayLike) -> PointValues:
        """`potential` and σ_h at any points of the mesh (collective).

        Args:
            points: Shape (n, dim). Each rank passes its own points, or none; their cells may be on any rank.

        Returns:
            The values at the points of this rank: NaN outside the mesh, and the values of one cell where several meet.

        Raises:
            InputError: On all ranks, if the points of one rank have another shape.
        """
        fields = self.potential, self.sigma
        return PointValues(*(at_points(self.spaces.domain, field, points) for field in fields))

    @collector_off()
    def probe(self, points: npt.ArrayLike) -> Columns:
        """What is known at points, by names: "u", "sigma" and what the physics adds (collective).

        Args:
            points: Shape (n, dim), the same on all ranks.

        Returns:
            For each name the values as `at` has them, also the same on all ranks: where several cells meet the mean of
            theirs, NaN outside the mesh.

        Raises:
            InputError: If the points have another shape.
        """
        x, domain = as_points(self.spaces.domain, points), self.spaces.domain
        fields = {"u": self.potential, "sigma": self.sigma}
        return {
            name: Spots.of(domain, x, field.function_space.mesh).of_function(field) for name, field in fields.items()
        }

    @collector_off()
    def through_section(self, points: npt.ArrayLike, normal: npt.ArrayLike | None = None) -> Through:
        """What flows through a section of the domain, exactly for σ_h: ∫σ_h·n and its size (collective).

        Args:
            points: In the plane the points of a polyline, shape (n, 2), with n to the right of who walks along it; in
                space a point of a plane, shape (1, 3).
            normal: The normal of the plane, shape (3,).

        Raises:
            InputError: If they have another shape.
        """
        x, dim = as_points(self.spaces.domain, points), self.spaces.mesh.geometry.dim
        if (dim == 2) is not (normal is None) or (len(x) < 2 if dim == 2 else len(x) != 1):
            raise InputError(
                "section: give at least two points of a polyline in the plane, in space a point and a normal"
            )
        return Profile(x, None if normal is None else np.asarray(normal, dtype=float)).through(
            self.spaces.domain, self.sigma
        )

    @cached_property
    def readings(self) -> dict[str, Columns]:
        """Tables of what is read off, which steps have too, by their names (collective when first used).

        They are those of the probes and sections of its case, the same on all ranks; others have rows on rank 0 alone.
        """
        probes, sections = (getattr(self.source, key, None) or () for key in ("probe", "section"))
        tables: dict[str, Columns] = {}
        if probes:
            points = np.array([point for each in probes for point in each.points])
            names = {"probe": np.array([label for each in probes for label in each.labels])}
            tables["probes"] = names | _in_columns({"": points, **self.probe(points)})
        if sections:
            found = [each.made().through(self.spaces.domain, self.sigma) for each in sections]
            names = {"section": np.array([each.name for each in sections])}
            flux = {"flux": np.array([each.flux for each in found])}
            tables["sections"] = names | _in_columns(flux) | {"measure": np.array([each.measure for each in found])}
        return tables

    def read_off(self) -> dict[str, float]:
        """Numbers that are read off, by names in words: those of probes and of the flux through sections (collective).

        Their places are not among them.
        """
        tables = [self.readings[name] for name in ("probes", "sections") if name in self.readings]
        return {
            f"{row} {key}": value
            for table in tables
            for row, values in by_name(table, None).items()
            for key, value in values.items()
            if key not in (*AXES, "measure")
        }

    def of_problem(self, problem: Any) -> Self:
        """The solution as one of a problem whose data have the same values but are given otherwise (collective)."""
        raise InputError(f"solutions of {self.physics} have no derivatives")

    def backend_of[B](self, kind: Callable[..., B]) -> B:
        """What has solved it, if it is of this kind and still set up for this solution; else a new one (collective)."""
        system = None if self.system is None else self.system()
        kept = None if system is None else system.kept.of(self.outcome, kind)
        return kept or kind(self.spaces, self.data, tuning=self.options.tuning)

    def linearised(self, tolerance: float) -> Any:
        """The problem linearised at this solution, which knows the change with its data (collective).

        Args:
            tolerance: Sites whose p and σ·n are on a corner of their law, but for this share of their sizes, are
                biactive.

        Raises:
            InputError: If there are no derivatives of such solutions.
        """
        raise InputError(f"solutions of {self.physics} have no derivatives")

    def of_step(self) -> dict[str, float]:
        """Numbers of a step that this physics has, for `steps.csv` (collective)."""
        return {}

    @abstractmethod
    def norms(self) -> dict[str, float]:
        """Norms of the fields (collective)."""

    @abstractmethod
    def errors(self) -> dict[str, float] | None:
        """Errors if the exact solution is known, otherwise None (collective)."""

    @abstractmethod
    def differences(self, coarse: Any) -> Any:
        """Norms of the difference from a solution on another mesh, by quadrature on that of this one (collective).

        The coarse fields are evaluated at the quadrature points. Near a curved boundary a point may be outside the
        coarse mesh; then the nearest coarse cell is used.

        Returns:
            A dataclass whose attributes are the norms.
        """

    @abstractmethod
    def sizes(self) -> dict[str, float]:
        """Norms of the solution itself, by the names of those of differences (collective)."""

    @abstractmethod
    def lines(self, summary: Mapping[str, Any]) -> dict[str, str]:
        """What a report tells of its summary beside that which all solutions have, by the names of the lines."""

    @abstractmethod
    def table(self) -> SiteTable:
        """One row for each site of this rank."""

    @abstractmethod
    def columns(self, table: Any) -> Columns:
        """The columns of this table that are written."""

    def other_tables(self) -> dict[str, Columns]:
        """Further tables by the names of their files, with their columns on rank 0 (collective)."""
        return {}

    @property
    def opposite(self) -> Surfaces | None:
        """What is opposite to Γ_S in pairs and has a table, `pairs.csv`, also of steps in time (collective)."""
        return None

    @abstractmethod
    def fields(self) -> Fields:
        """All fields, of which the files for ParaView and those of steps in time are made (collective)."""

    @collector_off()
    def summary(self) -> dict[str, Any]:
        """All numbers of the run, ready for JSON (collective)."""
        domain, outcome, errors, notes = self.spaces.domain, self.outcome, self.errors(), self.notes()
        return {
            "case": self.name,
            "title": self.title,
            "algorithm": self.options.algorithm_name,
            "backend": outcome.backend,
            "linear_solver": outcome.linear_solver,
            "mesh": domain.origin(),
            "h": domain.h,
            "cells": domain.cells,
            **self._sets(),
            "iterations": len(outcome.history),
            "rough_steps": outcome.rough_steps,
            "converged": outcome.converged,
            "reason": outcome.reason,
            "norms": self.norms(),
            **({} if errors is None else {"errors": errors}),
            **{name: by_name(self.readings[name]) for name in ("probes", "sections") if name in self.readings},
            "kkt": vars(self.kkt),
            **self._particular(),
            **({"notices": notes} if notes else {}),
            "timings": self.timings,
            "peak_memory": self.peak_memory,
            "ranks": domain.mesh.comm.size,
        }

    def notes(self) -> list[str]:
        """What a reader should know of problem and solution, in sentences (collective)."""
        return [*self.spaces.notices, *of_polygon(self.spaces)]

    def contradiction(self) -> str | None:
        """What in a solution that was read from a file excludes itself, beside residuals (collective)."""
        return None

    @abstractmethod
    def _sets(self) -> dict[str, Any]:
        """Numbers of facets and unknowns, and the contact set, for the summary (collective)."""

    @abstractmethod
    def _particular(self) -> dict[str, Any]:
        """What the summary of these solutions alone has (collective)."""

    def __repr__(self) -> str:
        ended = "converged" if self.converged else "failed"
        iterations = counted(len(self.outcome.history), "iteration")
        about = f"{self.options.algorithm_name}, {self.spaces.domain.cells} cells, {ended} after {iterations}"
        return f"<{type(self).__name__} of {self.name}: {about}>"

    def __dir__(self) -> list[str]:
        return sorted(self.offers)


def as_points(domain: Domain, points: npt.ArrayLike) -> Array:
    """Points of the dimension of a domain, shape (n, dim).

    Raises:
        InputError: If they have another shape.
    """
    x, dim = np.asarray(points, dtype=np.float64), domain.mesh.geometry.dim
    if x.ndim != 2 or x.shape[1] != dim:
        raise InputError(f"points: must be an array of shape (n, {dim}), a row for each point")
    return x


def by_name(table: Columns, most: int | None = IN_SUMMARY) -> dict[str, dict[str, float]]:
    """The first rows of a table by the names in their first column."""
    (_, names), *others = table.items()
    return {str(name): {key: float(column[i]) for key, column in others} for i, name in enumerate(names[:most])}


def _in_columns(values: Columns) -> dict[str, npt.NDArray]:
    """Columns of numbers: of vectors and matrices one for each component, such as sigma_x or sigma_xy."""
    columns = {}
    for name, of_name in values.items():
        for place in np.ndindex(of_name.shape[1:]):
            word = "".join(AXES[i] for i in place)
            columns["_".join(filter(None, (name, word)))] = of_name[:, *place]
    return columns
