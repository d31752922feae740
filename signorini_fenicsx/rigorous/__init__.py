"""The error bound as a theorem about the stored floats, rounding included."""
