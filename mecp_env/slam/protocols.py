"""What the stages of the estimator know of each other: associator and filter.

A filter takes and gives world coordinates and stable ids; how it stores them is private to it.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar, Protocol, Self

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.errors import MecpError
from mecp_env.core.sensors import Odometry
from mecp_env.slam.messages import Belief, Corners, MapView, Match, Polygon


class FilterError(MecpError):
    """An id the filter does not know, a wrong shape, or a covariance that is no longer positive."""


class AnswerError(FilterError):
    """A custom filter has answered with something of another type or shape: a mistake in it, no divergence."""


class FullFilterWarning(UserWarning):
    """The filter holds `max_landmarks`, and drops new ones from now on."""


class Filter(Protocol):
    """A landmark filter: pose (x, y, heading) and points, measured by range and bearing.

    `mecp_env.slam.filters.WindowFilter` is a base class that computes all tests from the joint Gaussian.

    Ids below `NO_ID` are marks of past poses (slam/panorama): they are updated like landmarks, but `ids` and `belief`
    leave them out.

    z (n,2) m, rad is measured in the robot frame with the joint covariance R (2n,2n), order r0, b0, r1, b1, ...
    `FilterError` is raised, and nothing repaired, when an innovation covariance is not positive.
    """

    dropped: int  # how many landmarks were not taken in because the filter was full

    @property
    def ids(self) -> Ints:
        """(N,) ids of the landmarks in the order of their initialisation."""

    def has(self, landmark: int) -> bool:
        """True when the filter holds a landmark with this id."""

    @abstractmethod
    def predict(self, odometry: Odometry) -> None:
        """Move the pose by the increments of one step."""

    @abstractmethod
    def update(self, z: Array, R: Array, ids: Ints, iterate: bool = False) -> None:
        """Correct by a whole scan at once; `iterate` relinearises until it settles."""

    @abstractmethod
    def augment(self, z: Array, R: Array, ids: Ints) -> None:
        """Take in new landmarks under ids never used before; those that find no room are counted in `dropped`."""

    def innovation(self, z: Array, R: Array, ids: Ints) -> tuple[Array, Array]:
        """nu (2n,) and S (2n,2n) of the pairing z[i] - ids[i], all cross terms included."""

    def individual_nis(self, z: Array, R: Array, ids: Ints) -> Array:
        """NIS (n,m) of every z (n,2), R (n,2,2) against every id (m,); inf where absurdly far."""

    def joint_nis(self, z: Array, R: Array, ids: Ints, iterate: bool = False) -> float:
        """Least joint cost of the pairing over pose and landmarks (2n degrees of freedom); iterated as `update`."""

    def log_bayes_factor(self, z: Array, R: Array, ids: Ints, pose_cov: Array) -> float:
        """Twice the log of p(pairs | a positive covariance (3,3) of x, y, heading more) / p(pairs | as it is)."""

    def mean_of_gaussians_nis(self, z: Array, R: Array, ids: Ints, paper_S: bool = False) -> float:
        """NIS (2 degrees of freedom) of the centre of the points z (k,2) against the landmarks' (eq. 2, 3)."""

    def marginal(self, ids: Ints) -> tuple[Array, Array]:
        """Mean (3+2m,) x, y, heading, landmarks and its covariance, in world coordinates."""

    @abstractmethod
    def fuse(self, keep: int, drop: int) -> None:
        """Merge two landmarks: both are at one place, then `drop` is removed."""

    @abstractmethod
    def remove(self, ids: Ints) -> None:
        """Forget landmarks."""

    def belief(self) -> Belief:
        """Pose and landmarks with their own covariances, in world coordinates; a copy."""

    @abstractmethod
    def copy(self) -> Self:
        """An independent filter with the same state: what association tries out does not touch the estimate."""

    @abstractmethod
    def loosen(self, pose_cov: Array) -> None:
        """Add a covariance (3,3) of x, y, heading to the pose: what odometry may be wrong by."""

    @abstractmethod
    def set_pose(self, T_map_robot: Array, pose_cov: Array | None = None) -> None:
        """The pose is this, independent of the landmarks, which keep their covariance.

        Without its covariance (3,3) it is exact (estimator "truth"); with one it was given from outside.
        """

    @abstractmethod
    def shift_pose(self, T_old_new: Array) -> None:
        """The pose becomes that of a frame at T_old_new (3,) in the present one (a laser off the robot's centre)."""


class Associator(Protocol):
    """Decides for each corner of a scan which landmark it is, if any. Derive from this class to get the defaults."""

    certain: ClassVar[bool] = False  # its pairs are right: where they do not fit (`Reason.REFUSED`), odometry failed

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """A new match with one decision per corner; the map and the filter stay as they are.

        The pipeline raises `MatchError` for columns of another length or type, ids that were never given out, and, of
        a custom associator, a landmark named twice or none of the map, and numbers of polygons that do not exist.
        """

    def remember(self, match: Match) -> None:
        """Called once per scan, after tracks and landmarks were initialised: `match` has the ids of new features."""
        return
