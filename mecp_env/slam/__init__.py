"""The estimator: from scans and odometry to pose, landmarks, rooms, doors and a semantic grid."""
