"""What solves one linear problem under given facet conditions; the contract is in `contract`."""
