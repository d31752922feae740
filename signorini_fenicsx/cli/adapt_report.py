"""The report of adaptive refinement."""

from collections.abc import Mapping

from signorini_fenicsx.certificate.adaptive import AdaptRow, MeasuredRow, rate
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.cli.case_report import CaseReport
from signorini_fenicsx.cli.solution_report import bound, interval
from signorini_fenicsx.quantities import Quantity


class AdaptReport(CaseReport):
    """What `signorini adapt` prints, and the rows of its meshes."""

    def __init__(self, **options: bool):
        super().__init__(**options)
        self.rows: list[AdaptRow] = []

    def columns(self, target: float | None, max_cells: int, widths: Mapping[str, float | None]) -> None:
        """Print when refinement ends, and name the columns; `widths` are lengths of intervals to reach."""
        wanted = "" if target is None else f"relative error ≤ {target:g} or "
        wanted += "".join(f"{name} is known to {width:g} or " for name, width in widths.items())
        length = f" {'length':>10}" if widths else ""
        self.line(f"until {wanted}{max_cells} cells")
        sizes = "".join(f" {name:>9}" for name in ("cells", "unknowns", "contact"))
        self.table(f"{'mesh':>13}{sizes} {'n':>3} {'error ≤':>10} {'relative':>9} {'seconds':>9}{length}")

    def mesh(self, row: AdaptRow) -> None:
        """Print the certified error on one mesh, and keep its row."""
        self.rows.append(row)
        self.row(
            f"{row.refinement:>9}{row.mesh:4d} {row.cells:9d} {row.unknowns:9d} {row.contact_measure:9.5g} "
            f"{row.iterations:3d} {row.bound:10.4e} {row.relative:9.3e} {row.seconds:9.2f}"
            + (f" {row.upper - row.lower:10.3e}" if isinstance(row, MeasuredRow) else "")
        )

    def adapted(self, best: float, certificate: Certificate, quantities: Mapping[str, Quantity]) -> None:
        """Print the last certificate, the fitted rates next to the best possible one, and quantities."""
        rates = {
            name: rate([row for row in self.rows if row.refinement == name])
            for name in dict.fromkeys(row.refinement for row in self.rows)
        }
        fitted = "  ".join(f"{name} {value:.2f}" for name, value in rates.items() if value is not None)
        if fitted:
            self.entry("slopes", f"{fitted}, of the error against the unknowns; best possible {best:.2f}")
        self.entry("certified", bound(certificate))
        for name, quantity in quantities.items():
            self.entry(name, interval(quantity))
