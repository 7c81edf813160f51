"""Ground truth: layouts, physics and sensors. The estimator imports none of it."""
