"""Case files: reading, checking and solving them."""
