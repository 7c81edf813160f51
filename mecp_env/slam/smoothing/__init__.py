"""Smoothing: past poses and landmarks from all scans of a run together, after the run."""

from mecp_env.slam.smoothing.optimum import Links, PoseGraph, Priors, Sightings, Smoothed, SmoothingError, smooth
from mecp_env.slam.smoothing.trace import FinalMap, Trace

__all__ = ["FinalMap", "Links", "PoseGraph", "Priors", "Sightings", "Smoothed", "SmoothingError", "Trace", "smooth"]
