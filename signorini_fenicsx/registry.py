"""All physics, and what writes and draws solutions; nothing of it is imported before it is used."""

from typing import Any

from signorini_fenicsx.solving.physics import DIFFUSION, OUTPUT, PHYSICS, Physics


class DiffusionPhysics(Physics):
    """A scalar u, its flux and Signorini's conditions."""

    def late(self, what: str) -> Any:
        """See `Physics.late`."""
        found: Any = None
        match what:
            case "problem":
                from signorini_fenicsx.physics.diffusion.problem import Diffusion as found
            case "system":
                from signorini_fenicsx.physics.diffusion.solving import System as found
            case "refining":
                from signorini_fenicsx.physics.diffusion.solving import refining as found
            case "keeping":
                from signorini_fenicsx.physics.diffusion.kept import KEEPING as found
            case "case":
                from signorini_fenicsx.physics.diffusion.case import Case as found
            case "bound":
                from signorini_fenicsx.physics.diffusion.bound.bounds import BOUNDS as found
            case "quantities":
                from signorini_fenicsx.physics.diffusion.quantities.brackets import QUANTITIES as found
            case "pictures":
                from signorini_fenicsx.physics.diffusion.show.pictures import PICTURES as found
            case "proofs":
                from signorini_fenicsx.rigorous.theorem import PROOFS as found
        return found


class ElasticityPhysics(Physics):
    """A body, its stress and contact with friction."""

    def late(self, what: str) -> Any:
        """See `Physics.late`."""
        found: Any = None
        match what:
            case "problem":
                from signorini_fenicsx.physics.elasticity.problem import Elasticity as found
            case "system":
                from signorini_fenicsx.physics.elasticity.solving import System as found
            case "keeping":
                from signorini_fenicsx.physics.elasticity.kept import KEEPING as found
            case "case":
                from signorini_fenicsx.physics.elasticity.case import ElasticCase as found
            case "bound":
                from signorini_fenicsx.physics.elasticity.bound.bounds import BOUNDS as found
            case "quantities":
                from signorini_fenicsx.physics.elasticity.quantities.brackets import QUANTITIES as found
            case "pictures":
                from signorini_fenicsx.physics.elasticity.show.pictures import PICTURES as found
            case "proofs":
                from signorini_fenicsx.rigorous.elasticity.theorem import PROOFS as found
        return found


class StokesPhysics(Physics):
    """A viscous flow, its pressure and laws on its boundary."""

    def late(self, what: str) -> Any:
        """See `Physics.late`."""
        found: Any = None
        match what:
            case "problem":
                from signorini_fenicsx.physics.stokes.problem import Stokes as found
            case "system":
                from signorini_fenicsx.physics.stokes.solving import System as found
            case "keeping":
                from signorini_fenicsx.physics.stokes.kept import KEEPING as found
            case "case":
                from signorini_fenicsx.physics.stokes.case import StokesCase as found
            case "bound":
                from signorini_fenicsx.physics.elasticity.bound.bounds import BOUNDS as found
            case "quantities":
                from signorini_fenicsx.physics.stokes.quantities import QUANTITIES as found
            case "pictures":
                from signorini_fenicsx.physics.stokes.show.pictures import PICTURES as found
        return found


def _write(*given: Any, **wanted: Any) -> None:
    from signorini_fenicsx.output.writing import write_solution

    write_solution(*given, **wanted)


def _plot(*given: Any) -> Any:
    from signorini_fenicsx.output.notebook import figure

    return figure(*given)


def _html(*given: Any) -> Any:
    from signorini_fenicsx.output.notebook import html

    return html(*given)


PHYSICS.update({DIFFUSION: DiffusionPhysics(), "elasticity": ElasticityPhysics(), "stokes": StokesPhysics()})
OUTPUT.update(write=_write, plot=_plot, html=_html)
