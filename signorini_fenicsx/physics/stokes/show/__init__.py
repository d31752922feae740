"""What is told and drawn of a viscous flow."""
