"""How problems of viscous flow are solved: as those of elasticity."""

from collections.abc import Mapping, Sequence

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.physics.elasticity import solving
from signorini_fenicsx.physics.elasticity.discrete.friction import FromBefore
from signorini_fenicsx.physics.elasticity.evolution import ElasticSteps
from signorini_fenicsx.physics.elasticity.problem import ElasticProblem
from signorini_fenicsx.physics.stokes.solution import StokesSolution
from signorini_fenicsx.physics.stokes.solvability import check_flow
from signorini_fenicsx.solving.solver import Wish


class FlowSteps(ElasticSteps):
    """The steps of data in time, each a flow of its own: nothing is remembered of those before."""

    def memory(self, _step: int, _before: Sequence[Array]) -> FromBefore:
        """Nothing."""
        return FromBefore()

    def by_earlier(self, _step: int, _by: Mapping[str, Array]) -> Sequence[tuple[int, Array]]:
        """No derivatives by what earlier steps have left."""
        return []


class System(solving.System):
    """The spaces of viscous flow on a mesh."""

    steps_type, solution_type = FlowSteps, StokesSolution

    def prepared(self, problem: ElasticProblem, wish: Wish) -> solving.ElasticRun:
        """Read the data and check them (collective).

        Raises:
            InputError: If the problem cannot be discretised as asked, or no flow exists.
        """
        run = super().prepared(problem, wish)
        check_flow(self.spaces, run.task.data)
        return run
