"""Noticing a wrong pose, and finding the right one again in the whole map."""
