"""Backends: each solves one linear problem under given conditions on sites. The contract is in `contract`."""
