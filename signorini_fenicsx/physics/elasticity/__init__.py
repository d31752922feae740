"""Elastic bodies in contact, in symmetric stresses of Johnson and Mercier and traces on facets."""
