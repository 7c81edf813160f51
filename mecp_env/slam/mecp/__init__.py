"""Corners to Maximum Empty Convex Polygons (III-A.2): search, wall-crossing check, edge labels."""
