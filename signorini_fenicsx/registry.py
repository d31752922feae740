"""All physics, and what writes and draws solutions; nothing of it is imported before it is used."""

# ruff: noqa: D102 - `Physics` says what its attributes are

from functools import cached_property
from typing import Any

from signorini_fenicsx.solving.physics import DIFFUSION, OUTPUT, PHYSICS, Physics


class Diffusion(Physics):
    """A scalar u, its flux and Signorini's conditions."""

    @cached_property
    def problem(self) -> Any:
        from signorini_fenicsx.physics.diffusion.problem import Diffusion

        return Diffusion

    @cached_property
    def system(self) -> Any:
        from signorini_fenicsx.physics.diffusion.solving import System

        return System

    @cached_property
    def refining(self) -> Any:
        from signorini_fenicsx.physics.diffusion.solving import refining

        return refining

    @cached_property
    def keeping(self) -> Any:
        from signorini_fenicsx.physics.diffusion.kept import KEEPING

        return KEEPING

    @cached_property
    def case(self) -> Any:
        from signorini_fenicsx.physics.diffusion.case import Case

        return Case

    @cached_property
    def bound(self) -> Any:
        from signorini_fenicsx.physics.diffusion.bound.bounds import BOUNDS

        return BOUNDS

    @cached_property
    def quantities(self) -> Any:
        from signorini_fenicsx.physics.diffusion.quantities.brackets import QUANTITIES

        return QUANTITIES

    @cached_property
    def pictures(self) -> Any:
        from signorini_fenicsx.physics.diffusion.show.pictures import PICTURES

        return PICTURES

    @cached_property
    def proofs(self) -> Any:
        from signorini_fenicsx.rigorous.theorem import PROOFS

        return PROOFS


class Elasticity(Physics):
    """A body, its stress and contact with friction."""

    @cached_property
    def problem(self) -> Any:
        from signorini_fenicsx.physics.elasticity.problem import Elasticity

        return Elasticity

    @cached_property
    def system(self) -> Any:
        from signorini_fenicsx.physics.elasticity.solving import System

        return System

    @cached_property
    def keeping(self) -> Any:
        from signorini_fenicsx.physics.elasticity.kept import KEEPING

        return KEEPING

    @cached_property
    def case(self) -> Any:
        from signorini_fenicsx.physics.elasticity.case import ElasticCase

        return ElasticCase

    @cached_property
    def bound(self) -> Any:
        from signorini_fenicsx.physics.elasticity.bound.bounds import BOUNDS

        return BOUNDS

    @cached_property
    def quantities(self) -> Any:
        from signorini_fenicsx.physics.elasticity.quantities.brackets import QUANTITIES

        return QUANTITIES

    @cached_property
    def pictures(self) -> Any:
        from signorini_fenicsx.physics.elasticity.show.pictures import PICTURES

        return PICTURES

    @cached_property
    def proofs(self) -> Any:
        from signorini_fenicsx.rigorous.elasticity.theorem import PROOFS

        return PROOFS


class Stokes(Physics):
    """A viscous flow, its pressure and laws on its boundary."""

    @cached_property
    def problem(self) -> Any:
        from signorini_fenicsx.physics.stokes.problem import Stokes

        return Stokes

    @cached_property
    def system(self) -> Any:
        from signorini_fenicsx.physics.stokes.solving import System

        return System

    @cached_property
    def keeping(self) -> Any:
        from signorini_fenicsx.physics.stokes.kept import KEEPING

        return KEEPING

    @cached_property
    def case(self) -> Any:
        from signorini_fenicsx.physics.stokes.case import StokesCase

        return StokesCase

    @cached_property
    def bound(self) -> Any:
        from signorini_fenicsx.physics.elasticity.bound.bounds import BOUNDS

        return BOUNDS

    @cached_property
    def quantities(self) -> Any:
        from signorini_fenicsx.physics.stokes.quantities import QUANTITIES

        return QUANTITIES

    @cached_property
    def pictures(self) -> Any:
        from signorini_fenicsx.physics.stokes.show.pictures import PICTURES

        return PICTURES


def _write(*given: Any, **wanted: Any) -> None:
    from signorini_fenicsx.output.writing import publish_solution

    publish_solution(*given, **wanted)


def _plot(*given: Any) -> Any:
    from signorini_fenicsx.output.notebook import figure

    return figure(*given)


def _html(*given: Any) -> Any:
    from signorini_fenicsx.output.notebook import html

    return html(*given)


PHYSICS.update({DIFFUSION: Diffusion(), "elasticity": Elasticity(), "stokes": Stokes()})
OUTPUT.update(write=_write, plot=_plot, html=_html)
