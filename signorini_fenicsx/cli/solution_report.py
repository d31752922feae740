"""The report of a run: its iterations, its solution, the bound of its error."""

from __future__ import annotations

import math
from collections.abc import Mapping
from decimal import ROUND_CEILING, Context, Decimal
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

from signorini_fenicsx.base.parallel import peak_memory
from signorini_fenicsx.base.signals import end_if_told
from signorini_fenicsx.base.text import counted, named
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.units import read_off, units_of
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.certificate.certify import FieldBound
from signorini_fenicsx.cli.case_report import CaseReport
from signorini_fenicsx.contact.history import OnStep, Step
from signorini_fenicsx.quantities import Quantity
from signorini_fenicsx.quantities.bracket import PASSES
from signorini_fenicsx.solving.solved import Solved

if TYPE_CHECKING:  # SciPy takes a second to load
    from signorini_fenicsx.certificate.proof import Proven
    from signorini_fenicsx.output.writing import Found

PARTS = {"gap": "energy gap", "oscillation": "data within cells", "remainder": "solver and penalty"}
"""What a bound is made of."""
WHOLE_TABLE = {True: 20, False: 1000}
"""Iterations up to which each is printed, on a terminal and in a log."""


class SolutionReport(CaseReport):
    """What `signorini solve` prints."""

    def begin(self, case: CaseFile, comm: MPI.Comm) -> None:
        """Print the heading of a case and its problem, and name the columns of the iterations."""
        self.heading(case, comm)
        penalty = f", ε = {case.solve.eps:g}" if case.method.has_eps else ""
        self.line(f"{case.fineness}{penalty}")
        self._penalised = case.method.penalty is not None
        names = (*case.states, *(("penalty", "clipped") if self._penalised else ()), "changed")
        counts = "".join(f"{name:>9}" for name in names)
        self.table(f"{'n':>4}{counts} {'‖δσ‖_V':>10} {'‖δu‖_Q':>10} {'seconds':>9}")

    def followed(self, comm: MPI.Comm) -> OnStep:
        """What is to be called after each iteration: it prints it, and ends the run if a signal has told so."""

        def on_step(row: Step) -> None:
            self.step(row)
            end_if_told(comm)

        return on_step

    def step(self, row: Step) -> None:
        """Print an iteration with sites as soon as it is done; of many on a terminal only those such as 30 or 400."""
        if row.sites == 0:
            return
        whole = math.inf if self._live.verbose else WHOLE_TABLE[self._live.alive]
        if row.iteration == whole + 1:
            self.row(f"{'…':>4} from here on only some; all are in history.csv, and printed with --verbose")
        if row.iteration > whole and row.iteration % 10 ** (len(str(row.iteration)) - 1) != 0:
            return
        penalty = (row.robin, row.clipped) if self._penalised else ()
        counts = "".join(f"{number:9d}" for number in (row.no_flux, row.zero_trace, *penalty, row.changed))
        changes = f"{row.sigma_change:10.2e} {row.u_change:10.2e} {row.seconds:9.2f}"
        self.row(f"{row.iteration:4d}{counts} {changes}{' rough' * row.rough}")

    def solution(self, result: Solved, found: Found) -> None:
        """Print the summary of a finished run, and what is known of its solution (collective)."""
        summary, certificate = result.summary(), found.certificate
        rough = f", {summary['rough_steps']} of them rough" if summary["rough_steps"] else ""
        lines = {
            "converged": f"{summary['reason']} after {counted(summary['iterations'], 'iteration')}{rough}",
            "mesh": mesh(result, summary),
            "system": f"{summary['backend']}, {summary['dofs']} unknowns, {summary['linear_solver']}",
            **result.lines(summary),
            **read_off(summary, units_of(result)),
            "norms": named(summary["norms"], ".6g"),
            "KKT": named(summary["kkt"], ".1e"),
        }
        if "errors" in summary:
            lines["errors"] = named(summary["errors"], ".4e")
        if certificate is not None:
            lines["certified"] = bound(certificate)
            if (error := summary.get("errors", {}).get("energy", 0.0)) > 0 and math.isfinite(certificate.bound):
                lines["certified"] += f"; bound/error {certificate.bound / error:.3g}" if not certificate.of else ""
            if found.proof is not None and found.proof.proven is not None:
                lines["proved"] = proved(found.proof.proven, certificate.error, found.proof.seconds)
        lines |= {name: interval(quantity) for name, quantity in (found.quantities or {}).items()}
        lines["seconds"] = named(summary["timings"], ".2f")
        most, comm = f"{summary['peak_memory'] / 2**20:.0f} MiB at most", result.spaces.mesh.comm
        of_rank = f", on one rank {peak_memory(comm, MPI.MAX) / 2**20:.0f}"
        lines["memory"] = most + of_rank * (comm.size > 1)
        self.entries(lines)
        self.notes(summary.get("notices", ()))
        if found.of_field is not None:
            self._field(found.of_field)

    def _field(self, bound: FieldBound) -> None:
        """Print how wrong a function of the user is."""
        share = f", {100 * bound.relative:.3g} % of ‖σ_h‖" if bound.relative < 1 else ""
        repair = "" if bound.repair is None else f"; it is {bound.repair:.1e} from an admissible function"
        trust = "" if bound.guaranteed else f"; not guaranteed: {bound.reason}"
        words = f"{below(bound.lower, 5)} ≤ energy error ≤ {above(bound.bound, 5)}{share}{repair}{trust}"
        self.entry("field", words if math.isfinite(bound.bound) else f"no error bound: {bound.reason}")


def mesh(result: Solved, summary: Mapping[str, Any]) -> str:
    """The mesh of a solution in words, with the facets in contact if there are any."""
    facets = result.spaces.Lambda.dofmap.index_map.size_global
    of_gamma = f", {facets} {result.gamma} facets" if facets else ""
    return f"h = {summary['h']:.5g}, {summary['cells']} cells{of_gamma}"


def bound(certificate: Certificate) -> str:
    """The error bound in words; if it is not guaranteed, the reason."""
    if not math.isfinite(certificate.bound):
        return f"no error bound: {certificate.if_none}{_reservation(certificate)}"
    return f"{certificate.error} {bounds_in_words(certificate)}{_reservation(certificate)}"


def interval(quantity: Quantity) -> str:
    """A quantity with its interval, in words; if that is not guaranteed, the reason."""
    symbol, unit = f"{quantity.symbol} = " * bool(quantity.symbol), f" {quantity.unit}" * bool(quantity.unit)
    if not math.isfinite(quantity.width):
        return f"{symbol}{quantity.value:.8g}{unit}, without bounds: {quantity.reason}"
    place = ", in" if quantity.lower <= quantity.value <= quantity.upper else " of the discrete solution, outside of"
    words = f"{symbol}{quantity.value:.8g}{place} [{below(quantity.lower, 8)}, {above(quantity.upper, 8)}]{unit}"
    words += f" for {quantity.of}" if quantity.of else ""
    words += f"; {100 * quantity.above_table:.3g} % of it {PASSES}" if quantity.above_table else ""
    return words if quantity.proved else f"{words}; not guaranteed: {quantity.reason}"


def bounds_in_words(certificate: Certificate) -> str:
    """The bounds of a certificate and what they are made of."""
    parts = ", ".join(f"{words} {getattr(certificate, name):.1e}" for name, words in PARTS.items())
    share = f"{100 * certificate.relative:.3g} % of ‖σ_h‖" if certificate.smaller_than_flux else "not below ‖σ_h‖"
    return f"≤ {certificate.bound:.4e}, {share}; of σ_h alone ≤ {certificate.sigma_bound:.4e} ({parts})"


def _reservation(certificate: Certificate) -> str:
    return f"; not guaranteed: {certificate.reservation}" if certificate.reservation else ""


def proved(bounds: Proven, error: str, seconds: float) -> str:
    """The proven error bound in words; all numbers are rounded up."""
    parts = ", ".join(f"{words} {above(getattr(bounds, name), 2)}" for name, words in PARTS.items())
    return (
        f"{error} ≤ {above(bounds.bound, 5)}; of σ_h alone ≤ {above(bounds.sigma_bound, 5)} ({parts}; {seconds:.1f} s)"
    )


def above(value: float, digits: int) -> str:
    """A number with this many digits that is not less than the float."""
    rounded = Context(prec=digits, rounding=ROUND_CEILING).create_decimal(Decimal(value))
    return f"{float(rounded):.{digits - 1}e}"


def below(value: float, digits: int) -> str:
    """A number with this many digits that is not more than the float."""
    return f"{-float(above(-value, digits)):.{digits - 1}e}"
