"""The report of a case: its contents, its expected cost, whether it can be solved."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from mpi4py import MPI

from signorini_fenicsx.base.text import counted, place_in_words
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.inspection import Checked, Expected, is_typical
from signorini_fenicsx.cli.report import Report
from signorini_fenicsx.solving.solved import Solved

NUMBERED = re.compile(r"(edge|face)\d+|\w+\.(edge|face)\d+")
"""Names of faces of a drawing that has none."""


class CaseReport(Report):
    """What commands print about a case, before or instead of solving it."""

    def heading(self, about: CaseFile | Solved, comm: MPI.Comm) -> None:
        """Print which problem is or was solved, and how."""
        self.title(about.title or about.name)
        self.line(f"{about.approach}, {counted(comm.size, 'rank')}")

    def expected(self, case: CaseFile, estimate: Expected) -> None:
        """Print the sizes of a case and the expected cost of a run."""
        about = "" if estimate.exact else "≈ "
        mesh = case.fineness.removeprefix("mesh ")
        self.entry("mesh", f"{mesh}, {about}{estimate.cells} cells, {about}{estimate.unknowns} unknowns")
        self._parts(estimate.parts)
        self._left(case, estimate.left)
        for name, cells in estimate.regions.items():
            self.entry("region", f"{name}: {cells} cells")
        usual = "" if is_typical(case) else "; from rates of alg1 to alg4 with the hybrid backend, others take more"
        self.entry("memory", f"≈ {estimate.memory / 2**20:.0f} MiB (an estimate{usual})")
        self.entry(
            "seconds",
            f"≈ {estimate.solver_seconds:.1f} to solve, {estimate.run_seconds:.0f} in all, without Gmsh's "
            f"(an estimate, for free cores{usual})",
        )

    def checked(self, case: CaseFile, sizes: Checked) -> None:
        """Print that a case can be solved, and its sizes."""
        counts = sizes.counts
        facets = ", ".join(f"{number} on Γ_{kind[0].upper()}" for kind, number in counts.items() if kind != "cells")
        self.entry("ready", f"{counts['cells']} cells; facets: {facets}")
        self._parts(sizes.parts)
        self._left(case, sizes.left)
        for what, line in sizes.cells:
            self.entry(what, line)
        for pair in sizes.pairs:
            self.entry("pair", pair)
        self.notes(sizes.remarks)

    def notes(self, sentences: Sequence[str]) -> None:
        """Print what is worth knowing besides."""
        for sentence in sentences:
            self.entry("note", sentence)

    def _parts(self, parts: Mapping[str, Mapping[str, Any]]) -> None:
        """Print what holds on each part of the boundary."""
        for name, part in parts.items():
            size = f", {part['facets']} facets, measure {part['measure']:.6g}" if "facets" in part else ""
            if NUMBERED.fullmatch(name) and part.get("center"):  # which one it is
                size += f", center {place_in_words(part['center'])}"
            self.entry("part", f"{name}: {part['condition']}{size}")

    def _left(self, case: CaseFile, left: Sequence[str]) -> None:
        """Print which parts are in Γ_D because no list has them."""
        if left:
            names = ", ".join(name or "facets in no part" for name in left)
            self.entry("Γ_D", f"{names}: in no list of [boundary], so {case.held} there")
