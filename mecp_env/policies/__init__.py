"""Explorers and their evaluation, through the public API of the environment."""
