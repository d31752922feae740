"""The systems, backends and iterations of elastic problems, what is checked before, and the residuals after."""
