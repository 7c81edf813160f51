"""The truth: layouts, physics and sensors. Nothing of the estimator imports it."""
