"""The heart: sites with a law, the set rules, and the one loop that all algorithms share; imports `base` alone."""
