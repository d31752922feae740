"""How a problem on a domain is solved, once and in steps in time, and what its solutions are."""
