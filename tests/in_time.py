"""Cases in time that are run, that end early and go on."""

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from mpi4py import MPI

from signorini_fenicsx.base.errors import NumericalFailure
from signorini_fenicsx.cli.evolving import EvolutionReport, solve_in_time
from signorini_fenicsx.output.steps import StepFolder
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.solving.evolving import Instant

COMM = MPI.COMM_WORLD


def run(
    about: Case,
    folder: Path,
    *,
    start_from: Path | None = None,
    restart: bool = False,
    certify_steps: bool = True,
    plot: bool = False,
) -> None:
    kept = {"restart": restart, "certify_steps": certify_steps}
    solve_in_time(about, COMM, EvolutionReport(quiet=True), folder, start_from, **kept, plot=plot)


def run_in_two(about: Case, folder: Path, step: int) -> None:
    """Run without bounds, fail after a step, and go on."""
    with ending_after(step), pytest.raises(NumericalFailure):
        run(about, folder, certify_steps=False)
    run(about, folder, restart=True, certify_steps=False)


def ending_after(step: int) -> AbstractContextManager[object]:
    """Let runs in time fail after the step with this number, which is saved."""
    save = StepFolder.save

    def ended(steps: StepFolder, instant: Instant, row: dict[str, Any]) -> None:
        save(steps, instant, row)
        if instant.step == step:
            raise NumericalFailure("ended", instant.solution)

    return mock.patch.object(StepFolder, "save", ended)
