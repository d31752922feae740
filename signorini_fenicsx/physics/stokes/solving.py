"""How problems of viscous flow are solved: as those of elasticity."""

from typing import Any

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.physics.elasticity import solving
from signorini_fenicsx.physics.elasticity.problem import ElasticProblem
from signorini_fenicsx.physics.elasticity.solve.task import ElasticTask
from signorini_fenicsx.physics.stokes.solution import StokesSolution
from signorini_fenicsx.physics.stokes.solvability import check_flow
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.system import Wish


class Run(solving.ElasticRun):
    """A problem of flow on its mesh, ready to be solved."""

    solution_type = StokesSolution


class System(solving.System):
    """The spaces of viscous flow on a mesh."""

    def prepared(self, problem: ElasticProblem, wish: Wish) -> solving.ElasticRun:
        """Read the data and check them (collective).

        Raises:
            InputError: If the problem cannot be discretised as asked, or no flow exists.
        """
        run = super().prepared(problem, wish)
        check_flow(self.spaces, run.task.data)
        return run

    def steps(self, *_: Any) -> Any:
        """There are none.

        Raises:
            InputError: Always.
        """
        raise InputError("[time]: a viscous flow has no steps in time")

    def run(self, task: ElasticTask, options: Options) -> solving.ElasticRun:
        """The problem, ready to be solved."""
        return Run(task, options)
