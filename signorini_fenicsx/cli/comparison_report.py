"""The reports of errors and differences of solutions."""

from pathlib import Path

from signorini_fenicsx.cli.case_report import CaseReport
from signorini_fenicsx.cli.report import Report
from signorini_fenicsx.comparing.comparison import Comparison
from signorini_fenicsx.comparing.convergence import ERRORS, ErrorRow, Vary
from signorini_fenicsx.methods.registry import Method


class ComparisonReport(Report):
    """What `signorini compare` prints."""

    def comparison(self, comparison: Comparison, first: Path, second: Path) -> None:
        """Print the differences of two runs."""
        one, other = comparison.contact
        norms = "  ".join(f"{word(name)} {value:.4e}" for name, value in vars(comparison.norms).items())
        lines = {
            "A": str(first),
            "B": str(second),
            "contact": f"measure {one:.6g} and {other:.6g}",
            "sets": f"Jaccard {comparison.jaccard:.6f}, Hausdorff distance {comparison.hausdorff:.4g}",
            "norms": norms,
            "relative": "  ".join(f"{word(name)} {value:.3e}" for name, value in comparison.relative.items()),
        }
        if comparison.phreatic is not None:
            lines["phreatic line"] = f"points up to {comparison.phreatic:.4g} apart"
        self.entries(lines | {name: f"{a:.6g} and {b:.6g}" for name, (a, b) in comparison.read_off.items()})


class ConvergenceReport(CaseReport):
    """What `signorini convergence` prints."""

    _named = False

    def errors(self, row: ErrorRow) -> None:
        """Print the errors of one run, below the names of the columns."""
        if not self._named:
            names = "".join(f" {word(name):>11} {'order':>5}" for name in row.errors)
            slides = "".join(f" {'slides ' + word(name)[2]:>9}" for name in row.slides)
            self.table(f"{'h':>8} {'ε':>8} {'cells':>8} {'n':>3}{names}{slides}")
            self._named = True
        errors = "".join(
            f" {_cell(error, 11, '.3g')} {_cell(row.orders[name], 5, '.2f')}" for name, error in row.errors.items()
        )
        slides = "".join(f" {_cell(error, 9, '.3g')}" for error in row.slides.values())
        self.row(f"{row.h:8.5f} {_cell(row.eps, 8, '.1e')} {row.cells:8d} {row.iterations:3d}{errors}{slides}")

    def slopes(self, slopes: dict[str, float], vary: Vary, method: Method) -> None:
        """Print the fitted slopes next to those of the theory."""
        of_h = "h (8)" if method.penalty is None else "h (30), (32)"
        theory = {
            Vary.H: "h² where u is smooth, h^(3/2) where contact ends" if "energy" in slopes else of_h,
            Vary.EPS: "ε" if method.stabilised else "√ε in general, ε for a regular flux (21)-(24)",
        }.get(vary, "h + √ε (29), (31)")
        fitted = "  ".join(f"{word(name)} {slope:.2f}" for name, slope in slopes.items())
        self.line(f"fitted slopes  {fitted}   theory: {theory}")


def word(name: str) -> str:
    """What reports call a norm of a difference."""
    return ERRORS.get(name, name)


def _cell(value: float | None, width: int, form: str) -> str:
    return f"{'-' if value is None else format(value, form):>{width}}"
