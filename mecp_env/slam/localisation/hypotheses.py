"""Which of the poses that a search has found is the right one, if that is clear."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mecp_env.slam.config import LocalisationConfig
from mecp_env.slam.localisation.relocalisation import Located


class Hypothesis(NamedTuple):
    """A pose that some corners speak for, and what all beams say of it."""

    at: Located
    share: float  # of the beams in mapped space that agree, nan: nothing is mapped there
    explained: float  # share of all beams, or of the corners, that the map explains
    near: bool  # failed odometry may be all that is between it and the prediction

    def is_sound(self, config: LocalisationConfig) -> bool:
        """True when the map explains enough of the scan, and contradicts little of it."""
        return self.explained >= config.explained_share and not self.share < config.explained_share

    def may_be(self, other: Hypothesis, margin: int) -> bool:
        """True when the robot may as well be at the `other` pose."""
        return len(other.at.corners) > len(self.at.corners) - margin or other.share > self.share


NONE = np.empty(0, np.int64)
NOWHERE = Hypothesis(Located(np.zeros(3), np.zeros((3, 3)), NONE, NONE), 0.0, -1.0, near=False)


def clear_winner(hypotheses: list[Hypothesis], config: LocalisationConfig) -> Hypothesis | None:
    """The pose that most corners speak for, if it explains enough of the scan and no other pose may be the right one.

    Another may be that nearly as many corners speak for, or that agrees better with what is mapped there. A near pose
    that explains the scan as well as any needs to fear other near ones only: odometry that fails is likelier than a
    robot that is carried off, and a place that was seen just now has few landmarks yet.
    """
    best, *others = _candidates(hypotheses, config) or [NOWHERE]
    enough = len(best.at.corners) + best.near >= config.least_corners
    rivals = (one for one in others if best.may_be(one, config.margin))
    clear = enough and best.is_sound(config) and not any(best.at.differs_from(one.at) for one in rivals)
    return best if clear else None


def _candidates(hypotheses: list[Hypothesis], config: LocalisationConfig) -> list[Hypothesis]:
    """The poses that the map does not contradict; the near ones alone, if they explain the scan nearly as well as any.

    Nearly: by a tenth of what a pose may leave unexplained. In a corridor of equal bays some other often explains a few
    beams more.
    """
    possible = [one for one in hypotheses if not one.share < config.explained_share]
    most = max((one.explained for one in possible), default=0.0)
    as_well = most - 0.1 * (1.0 - config.explained_share)
    return [one for one in possible if one.near and one.explained >= as_well] or possible
