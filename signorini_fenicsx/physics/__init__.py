"""The physics that can be solved: each has a folder of its own, with files of the same names."""
