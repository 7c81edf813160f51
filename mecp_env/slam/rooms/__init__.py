"""Rooms and the doors between them (III)."""
