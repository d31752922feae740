"""Pictures of a solution; what they show is declared by each physics, in `physics/*/show/pictures.py`."""
