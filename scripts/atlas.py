"""Runs the commands of the reference atlas, data/atlas/atlas.csv, again and writes what they find into it.

Usage: uv run python scripts/atlas.py [PROBLEM …]

A row has a problem, a quantity, its interval, whether that is guaranteed, the unknowns of the last mesh, and the
command that finds them. The ends are rounded outwards to a hundredth of the length. Without a problem all are run, one
after another. It prints the table of docs/measured/atlas.md.
"""

import csv
import json
import math
import shlex
import subprocess
import sys
from collections.abc import Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from pathlib import Path
from tempfile import TemporaryDirectory

ATLAS = Path(__file__).parents[1] / "data" / "atlas" / "atlas.csv"


def read_atlas() -> list[dict[str, str]]:
    """The rows of the atlas."""
    with ATLAS.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def write_atlas(rows: Sequence[dict[str, str]]) -> None:
    """Write the atlas."""
    with ATLAS.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def rounded(lower: float, upper: float) -> tuple[str, str]:
    """The ends of an interval as decimals, rounded outwards to a hundredth of its length."""
    unit = Decimal(1).scaleb(math.floor(math.log10(upper - lower)) - 2)
    return str(Decimal(lower).quantize(unit, ROUND_FLOOR)), str(Decimal(upper).quantize(unit, ROUND_CEILING))


def rerun(row: dict[str, str], *options: str) -> dict[str, str]:
    """The row as its command finds it, with more options.

    Raises:
        subprocess.CalledProcessError: If the command fails.
    """
    program, *arguments = shlex.split(row["command"])
    with TemporaryDirectory() as folder:
        where = ["--output", f"{folder}/found", "--quiet"]
        command = [str(Path(sys.executable).with_name(program)), *arguments, *options, *where]
        subprocess.run(command, check=True)
        summary = json.loads(Path(folder, "found", "summary.json").read_text(encoding="utf-8"))
    interval = summary["quantities"][row["quantity"]]
    lower, upper = rounded(interval["lower"], interval["upper"])
    guaranteed = "yes" if interval["guaranteed"] else "no"
    return row | {"lower": lower, "upper": upper, "guaranteed": guaranteed, "unknowns": str(summary["dofs"])}


def line(row: dict[str, str]) -> str:
    """The row in the table of the documentation."""
    sure = "" if row["guaranteed"] == "yes" else ", not guaranteed"
    return f"| {row['problem']} | {row['quantity']} | [{row['lower']}, {row['upper']}]{sure} | {row['unknowns']} |"


def main(names: Sequence[str]) -> None:
    """Run the commands of some problems, of all for none."""
    rows = read_atlas()
    unknown = set(names) - {row["problem"] for row in rows}
    if unknown:
        sys.exit(f"error: the atlas has no problem {', '.join(sorted(unknown))}")
    for number, row in enumerate(rows):
        if not names or row["problem"] in names:
            rows[number] = rerun(row)
            write_atlas(rows)
        sys.stdout.write(f"{line(rows[number])}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
