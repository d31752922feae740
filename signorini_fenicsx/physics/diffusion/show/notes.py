"""What a reader should know of the data of a scalar problem, in sentences."""

from signorini_fenicsx.discrete.continuity import NO_TRACE, TIGHTER, jump_in_words
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces


def notes_of(spaces: Spaces, data: Data) -> list[str]:
    """Where u_D jumps, or a bound of u on Γ_S or in Ω (collective)."""
    notes = jump_in_words(spaces, "u_D", data.u_D, spaces.dirichlet_facets, NO_TRACE)
    for part in (*data.laws.of_parts, *data.inside.of_regions):
        entities = part.rows.astype("int32") if part.law.region else spaces.facets[part.rows]
        for key, datum in part.data.items():
            if any(datum is bound for bound in part.bounds):
                name = part.key(key)
                notes += jump_in_words(spaces, name, datum, entities, TIGHTER, cells=bool(part.law.region))
    return notes
