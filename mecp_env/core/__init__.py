"""Shared foundation: imports no other part of the package."""
