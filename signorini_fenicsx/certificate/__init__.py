"""The guaranteed bound of the error, and the refinement that it steers."""
