"""The systems, backends and iterations of diffusion problems, what is checked before, and the residuals after."""
