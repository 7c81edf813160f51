"""The persistent map: tracks, landmarks, map polygons, merging, pruning, dynamic objects."""
