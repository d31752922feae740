"""Solutions, from a domain, a boundary and a problem."""
