"""The error bound of elastic contact as a theorem about the stored floats, rounding included."""
