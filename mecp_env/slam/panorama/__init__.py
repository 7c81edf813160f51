"""Recent scans around the robot: what a laser with a blind side has seen, registered by the filter's own poses."""
