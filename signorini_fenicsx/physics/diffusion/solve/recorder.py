"""The history of a method that has no backend, but makes iterates in the mixed spaces itself."""

from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import SiteConditions
from signorini_fenicsx.contact.history import History, OnStep
from signorini_fenicsx.discrete.field_change import FieldChange
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces


class Recorder(History):
    """A history of iterates in V_h × Q_h, each compared with the one before; for methods without a backend."""

    def __init__(self, spaces: Spaces, iterate: Iterate, conditions: SiteConditions, on_step: OnStep):
        """Begin with the start, which is not a step itself (collective).

        Args:
            spaces: The discrete spaces.
            iterate: The start.
            conditions: Its facet conditions.
            on_step: Called on all ranks with each step.
        """
        self._last, self._change = iterate, FieldChange(iterate.sigma.function_space, iterate.u.function_space)
        super().__init__(spaces.mesh.comm, on_step)
        self.start_from(conditions)

    def add(self, iterate: Iterate, conditions: SiteConditions) -> None:
        """Record an iteration (collective)."""
        change, self._last = self._change(iterate, self._last), iterate
        self.append(conditions, change, lambda: (iterate, conditions), linear_iterations=iterate.linear_iterations)
