"""From a domain, a boundary and a problem to a solution."""
