"""The guaranteed bound of scalar problems: an equilibrated flux, a conforming function, and what loads leave."""
