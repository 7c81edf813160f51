"""Belief to way: goals, paths, control, and the paper's explorer. Knows the estimate only, never the truth."""
