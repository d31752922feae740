"""Case files: reading them, what they mean, solving them."""
