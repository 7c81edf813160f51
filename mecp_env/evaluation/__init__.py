"""Ground-truth metrics and map scores of an episode."""
