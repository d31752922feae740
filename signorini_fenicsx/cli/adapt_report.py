"""The report of adaptive refinement."""

from signorini_fenicsx.certificate.adaptive import AdaptRow, rate
from signorini_fenicsx.certificate.certify import Certificate
from signorini_fenicsx.cli.case_report import CaseReport
from signorini_fenicsx.cli.solution_report import bound


class AdaptReport(CaseReport):
    """What `signorini adapt` prints."""

    def columns(self, target: float | None, max_cells: int) -> None:
        """Print when refinement ends, and name the columns."""
        wanted = "" if target is None else f"relative error ≤ {target:g} or "
        self.line(f"until {wanted}{max_cells} cells")
        sizes = "".join(f" {name:>9}" for name in ("cells", "unknowns", "contact"))
        self.table(f"{'mesh':>13}{sizes} {'n':>3} {'error ≤':>10} {'relative':>9} {'seconds':>9}")

    def mesh(self, row: AdaptRow) -> None:
        """Print the certified error on one mesh."""
        self.row(
            f"{row.refinement:>9}{row.mesh:4d} {row.cells:9d} {row.unknowns:9d} {row.contact_measure:9.5g} "
            f"{row.iterations:3d} {row.bound:10.4e} {row.relative:9.3e} {row.seconds:9.2f}"
        )

    def adapted(self, rows: list[AdaptRow], best: float, certificate: Certificate) -> None:
        """Print the last certificate, and the fitted rates next to the best possible rate."""
        rates = {
            name: rate([row for row in rows if row.refinement == name])
            for name in dict.fromkeys(r.refinement for r in rows)
        }
        fitted = "  ".join(f"{name} {value:.2f}" for name, value in rates.items() if value is not None)
        if fitted:
            self.entry("slopes", f"{fitted}, of the error against the unknowns; best possible {best:.2f}")
        self.entry("certified", bound(certificate))
