"""The EKF of the paper."""

from __future__ import annotations

from mecp_env.slam.filters.core import LandmarkFilter


class Ekf(LandmarkFilter):
    """Plain EKF-SLAM (III, "EKF-SLAM framework"): additive errors of pose and landmarks, P_rl = F P_rl.

    Over-confident once the heading is uncertain: it gains false information about the global orientation, because each
    linearisation sees a different unobservable direction. Source: Smith, Self and Cheeseman, 1990.
    """

    invariant = False
