"""A point mass that leaves a ring through one of three gates: the smallest task with several ways."""
