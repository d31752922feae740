"""Measures the program: seconds and memory, beside other programs, and beside known values.

    uv run python scripts/measure.py WHAT …          (WHAT --help tells the options)

`benchmark`   seconds beside P1 and P2 of scikit-fem and NGSolve at equal errors (`uv run --group bench`)
`scaling`     seconds, memory and messages over ranks
`gradients`   seconds and memory of gradients beside solves
`methods`     all algorithms on all examples
`adaptive`    what adaptive refinement gains; `quantities` for intervals of quantities
`orders`      how intervals of quantities shrink with h
`elastic`     a pressed block beside one linear solve and P2 (`uv run --group bench`), with friction, two bodies, or
              as a flow
`friction`    how many linear problems friction in space takes
`pairs`       what pairs of surfaces cost (also under mpirun)
`soils`       how many linear problems soils take; `soil-columns` in time
`korn`        constants of bounds of bodies; `proved-korn` with rounding included
`mindlin`     a sphere pressed onto a block and pushed, beside the theory of half-spaces
`plate`       what the error bound says of published values
`penalty`     the statements of the slides on the penalty formulations

`ours` and `conforming` are what `benchmark` starts in processes of their own.
"""

import sys
from importlib import import_module

import typer

MODULES = {
    **dict.fromkeys(["benchmark", "ours"], "benchmark"),
    **dict.fromkeys(["scaling", "gradients"], "runs"),
    **dict.fromkeys(["methods", "adaptive", "quantities", "orders"], "methods"),
    **dict.fromkeys(["elastic", "friction", "pairs"], "elastic"),
    **dict.fromkeys(["korn", "proved-korn"], "korn"),
    **dict.fromkeys(["mindlin", "plate", "penalty", "soils", "soil-columns"], "published"),
    "conforming": "conforming",
}
"""Where each is, in `measuring`."""


def main() -> None:
    """Measure what is asked for."""
    what = sys.argv.pop(1) if len(sys.argv) > 1 else ""
    if what not in MODULES:
        sys.exit(__doc__)
    app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)
    try:
        module = import_module(f"measuring.{MODULES[what]}")
    except ModuleNotFoundError as missing:
        sys.exit(f"{what} needs {missing.name}: uv run --group bench python scripts/measure.py {what}")
    app.command()(getattr(module, what.replace("-", "_")))
    app()


if __name__ == "__main__":
    main()
