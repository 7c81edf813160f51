"""The semantic occupancy grid, painted from the current estimates."""
