"""The report of adaptive refinement."""

from collections.abc import Mapping

from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.certificate.adaptive import AdaptRow, rate
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.cli.case_report import CaseReport
from signorini_fenicsx.cli.solution_report import bound, interval
from signorini_fenicsx.quantities import Quantity


class AdaptReport(CaseReport):
    """What `signorini adapt` prints, and the rows of its meshes."""

    def __init__(self, **options: bool):
        super().__init__(**options)
        self.rows: list[AdaptRow] = []

    def columns(self, target: float | None, max_cells: int, widths: Mapping[str, float | None], case: CaseFile) -> None:
        """Print when refinement ends, and name the columns; `widths` are lengths of intervals to reach."""
        wanted = "" if target is None else f"relative error ≤ {target:g} or "
        wanted += "".join(f"{name} is known to {width:g} or " for name, width in widths.items())
        length = "".join(f" {each.name:>11} {'length':>10}" for each in case.quantity)
        self.line(f"until {wanted}{max_cells} cells")
        sizes = "".join(f" {name:>9}" for name in ("cells", "unknowns", "contact"))
        self.table(f"{'mesh':>13}{sizes} {'n':>3} {'error ≤':>10} {'relative':>9} {'seconds':>9}{length}")

    def mesh(self, row: AdaptRow) -> None:
        """Print the certified error on one mesh, and keep its row."""
        self.rows.append(row)
        self.row(
            f"{row.refinement:>9}{row.mesh:4d} {row.cells:9d} {row.unknowns:9d} {row.contact_measure:9.5g} "
            f"{row.iterations:3d} {row.bound:10.4e} {row.relative:9.3e} {row.seconds:9.2f}"
            + "".join(
                f" {each.value:{max(11, len(name))}.6g} {each.width:10.3e}" for name, each in row.quantities.items()
            )
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
