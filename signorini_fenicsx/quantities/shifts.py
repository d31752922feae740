"""Problems whose data differ a little: loads with more in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.expressions.given import Given, combined, parsed
from signorini_fenicsx.meshes.domain import Domain, other_side


def added(domain: Domain, one: Given, other: Given, factor: float) -> Given:
    """The sum of a datum and a multiple of another one.

    Raises:
        InputError: If one of them is a function of points.
    """
    names = "xyz"[: domain.mesh.geometry.dim]
    one, other = (parsed(given, names, "weight") for given in (one, other))
    return combined(one, other, factor, "data of a problem with quantities")


def in_regions(
    domain: Domain, f: Given | Mapping[str, Given], weight: Given, region: Sequence[str], factor: float
) -> Given | Mapping[str, Given]:
    """A load that is larger by a multiple of a weight in some regions, none for all of Ω.

    Raises:
        InputError: If a region is unknown.
    """
    regions = domain.regions
    for name in region:
        if name not in regions:
            there_are = f"its regions are {', '.join(regions)}" if regions else "it has none"
            raise InputError(f"unknown region '{name}' of the mesh; {there_are}")
    if not region and not isinstance(f, Mapping):
        return added(domain, f, weight, factor)
    of_region = {name: f[name] if isinstance(f, Mapping) else f for name in regions}
    return {
        name: added(domain, own, weight, factor) if not region or name in region else own
        for name, own in of_region.items()
    }


def check_part(domain: Domain, boundary: Any, part: str, other: str = "for which n has the other direction") -> None:
    """Refuse what is no part, and the other side of one inside the domain, with what is different on the named one.

    Raises:
        InputError: If it is.
    """
    if part not in domain.facets:
        raise InputError(f"unknown part '{part}'; there are {', '.join(domain.facets)}")
    across = {other_side(named): named for named in boundary.inner}
    if part in across:
        raise InputError(f"the part '{part}' has no law; take '{across[part]}', {other}")
