"""The bound of elastic problems: an equilibrated stress, a conforming displacement, and what loads leave."""
