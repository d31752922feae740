"""What `measure.py` measures."""
