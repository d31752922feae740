"""Methods that find the contact sets: the registry, what methods get, and how set rules start and end."""
