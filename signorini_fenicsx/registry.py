"""All physics, and what writes and draws solutions; nothing of it is imported before it is used."""

from signorini_fenicsx.solving.physics import DIFFUSION, OUTPUT, PHYSICS, Physics

PHYSICS[DIFFUSION] = Physics(
    problem="signorini_fenicsx.physics.diffusion.problem:Diffusion",
    system="signorini_fenicsx.physics.diffusion.solving:System",
    refining="signorini_fenicsx.physics.diffusion.solving:refining",
    keeping="signorini_fenicsx.physics.diffusion.kept:KEEPING",
    case="signorini_fenicsx.physics.diffusion.case:Case",
    bound="signorini_fenicsx.physics.diffusion.bound.bounds:BOUNDS",
    quantities="signorini_fenicsx.physics.diffusion.quantities.brackets:QUANTITIES",
    pictures="signorini_fenicsx.physics.diffusion.show.pictures:PICTURES",
    proofs="signorini_fenicsx.rigorous.theorem:PROOFS",
)
PHYSICS["elasticity"] = Physics(
    problem="signorini_fenicsx.physics.elasticity.problem:Elasticity",
    system="signorini_fenicsx.physics.elasticity.solving:System",
    keeping="signorini_fenicsx.physics.elasticity.kept:KEEPING",
    case="signorini_fenicsx.physics.elasticity.case:ElasticCase",
    bound="signorini_fenicsx.physics.elasticity.bound.bounds:BOUNDS",
    quantities="signorini_fenicsx.physics.elasticity.quantities.brackets:QUANTITIES",
    pictures="signorini_fenicsx.physics.elasticity.show.pictures:PICTURES",
    proofs="signorini_fenicsx.rigorous.elasticity.theorem:PROOFS",
)
PHYSICS["stokes"] = Physics(
    problem="signorini_fenicsx.physics.stokes.problem:Stokes",
    system="signorini_fenicsx.physics.stokes.solving:System",
    keeping="signorini_fenicsx.physics.stokes.kept:KEEPING",
    case="signorini_fenicsx.physics.stokes.case:StokesCase",
    bound="signorini_fenicsx.physics.elasticity.bound.bounds:BOUNDS",
    quantities="signorini_fenicsx.physics.stokes.quantities:QUANTITIES",
    pictures="signorini_fenicsx.physics.stokes.show.pictures:PICTURES",
)
OUTPUT.update(
    write="signorini_fenicsx.output.writing:publish_solution",
    plot="signorini_fenicsx.output.notebook:figure",
    html="signorini_fenicsx.output.notebook:html",
)
