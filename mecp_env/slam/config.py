"""Configuration of the estimator: one frozen section a stage, the paper's value named beside each."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, Field

from mecp_env.core.errors import ConfigError
from mecp_env.core.sensors import LASERS, LaserNoise
from mecp_env.core.settings import Names, Settings, guess, shown
from mecp_env.slam.messages import Belief


def _ordered(limits: tuple[float, float]) -> tuple[float, float]:
    low, high = limits
    if not 0.0 <= low <= high:
        raise ValueError(f"expected 0 <= least <= most, given {low:g}, {high:g}")
    return limits


Limits = Annotated[tuple[float, float], AfterValidator(_ordered)]  # least and most


def chi2_of_point(probability: float) -> float:
    """The NIS that a point's error stays under with this probability: chi-square with two degrees of freedom."""
    return -2.0 * math.log(1.0 - probability)


RIVALS = ("jcbb", "ccda", "joint_descriptor", "nearest", "nearest_room", "nearest_descriptor")
METHODS = Names("mecp", "mecp_paper", *RIVALS, "known", by="register_associator")
KINDS = Names("riekf", "riekf_submaps", "ekf", "fej", by="register_filter")
STRUCTURE_NAMES = Names("mecp", "largest_area", "dobkin", by="register_structure")


class SensorModel(LaserNoise):
    """What the estimator believes of its laser; view and noise follow that of the environment (`FOLLOWING`)."""

    least_range_sigma_m: float = Field(0.001, gt=0.0, le=1.0)  # of an ideal laser: covariances stay invertible
    noise_sigmas: float = Field(3.0, gt=0.0, le=20.0)  # what differs by more standard deviations is not noise
    outlier_sigmas: float = Field(4.0, gt=0.0, le=20.0)  # a single beam that is off by more is an outlier
    edge_beams: int = Field(2, ge=1, le=10)  # that bearing noise mixes at an edge: left out of a line's fit, where the
    # segment is long enough; one more makes sure
    least_cosine: float = Field(0.035, gt=0.0, le=0.5)  # of the incidence (88 deg) at which a ray still meets its line
    face_gain: float = Field(12.0, ge=0.0, le=1000.0)  # chi-square that a face too short for a segment must save
    merge_slope: float = Field(4.0, ge=0.0, le=100.0)
    """Ranges of one surface differ by this slope times range and bearing step: a surface seen at up to 76 deg."""

    @classmethod
    def preset(cls, name: str, **fields: Any) -> Self:
        """The noise and view of a laser that exists, such as "urg04lx"; `fields` replace those of it, `x_m` is 0.

        Raises `ConfigError` for an unknown name or field.
        """
        if name not in LASERS:
            raise ConfigError(f"preset: {shown(name)}, one of {', '.join(LASERS)} expected{guess(name, LASERS)}")
        known = {key: value for key, value in LASERS[name].items() if key in LaserNoise.model_fields and key != "x_m"}
        return cls(**{**known, **fields})


class ClusteringConfig(Settings):
    """III-A.1, data clustering."""

    DERIVED: ClassVar = ("is_adaptive", "allows_noise", "is_union")

    threshold: Literal["adaptive_noise", "adaptive", "fixed"] = "adaptive_noise"  # paper: "adaptive", no noise term
    grazing_deg: float = Field(85.0, gt=45.0, lt=90.0)  # paper: 85
    fixed_m: float = Field(0.3, gt=0.0, le=5.0)
    sweeps: Literal["mean", "union"] = "mean"  # of a dense scan: one mean per bearing, or every beam; paper: "union"

    @property
    def is_adaptive(self) -> bool:
        """True where the threshold grows with the range."""
        return self.threshold != "fixed"

    @property
    def allows_noise(self) -> bool:
        """True where noise widens the threshold."""
        return self.threshold == "adaptive_noise"

    @property
    def is_union(self) -> bool:
        """True where every beam of a dense scan is kept."""
        return self.sweeps == "union"

    def united(self, sweeps: int) -> int:
        """How many sweeps the beams of a scan with so many are the union of."""
        return sweeps if self.is_union else 1


class SegmentConfig(Settings):
    """III-A.1, split-and-merge (Ramer-Douglas-Peucker) and the line fit; a wall has room for one."""

    DERIVED: ClassVar = ("long_beams",)

    min_beams: int = Field(5, ge=3, le=100)
    min_length_m: float = Field(0.25, gt=0.0, le=5.0)
    merge_gain: float = Field(25.0, ge=0.0, le=1000.0)  # chi-square that a break must save; 0: each stays; paper: 0
    shift_beams: int = Field(8, ge=0, le=100)  # by which a break may move; the longest piece to absorb, or end face;
    # 0: plain Ramer-Douglas-Peucker, as the paper's
    max_alpha_sigma_deg: float = Field(8.0, gt=0.0, le=45.0)
    parameter_gain: float = Field(4.0, ge=0.0, le=1000.0)  # chi-square that each parameter of a circle must save
    pillar_radius_m: float = Field(0.8, ge=0.0, le=5.0)  # a cluster that fits a smaller circle is a pillar; paper: none

    @property
    def long_beams(self) -> int:
        """From three times as many as the least on, a bad fit widens the covariance; below it discards the line."""
        return 3 * self.min_beams


class GapConfig(Settings):
    """III, doors: which gaps between two line ends are doors."""

    oblique_deg: float = Field(60.0, gt=0.0, lt=90.0)  # between the walls beside a door, where it is in line with one
    deep_share: float = Field(0.25, ge=0.0, le=1.0)  # of the beams between the jambs go on deeper than any wall: else
    # it is a niche
    plain_width_m: float = Field(1.3, gt=0.0, le=10.0)  # wider, a gap is a door only between walls in line, and
    # where the floor is seen to get wider behind it, just deeper than any wall


class CornerConfig(Settings):
    """III-A.1, line intersections and line end points; door jambs (III: fixed unique width for doors)."""

    DERIVED: ClassVar = ("is_constant",)

    min_angle_deg: float = Field(15.0, gt=0.0, lt=90.0)  # between two lines that intersect at a corner; else parallel
    detail_m: float = Field(0.25, gt=0.0, le=5.0)  # two corners nearer are one; beams behind an end are farther
    line_m: float = Field(0.1, gt=0.0, le=2.0)  # off a line, or off the end of a segment by less: on it
    reach_beams: int = Field(14, ge=3, le=100)  # beside an end, looked at for a second face
    step_share: float = Field(0.1, ge=0.0, le=1.0)  # of the range, by which consecutive beams of one surface differ
    wall_thickness_m: float = Field(0.75, gt=0.0, le=5.0)  # a shorter face may be the end of a wall, and gaps whose
    # middles are nearer are one
    short_faces: bool = True  # corners with a face too short for a segment, at a right angle; paper: none
    passing_cost: float = Field(5.0, ge=0.0, le=100.0)  # chi-square of a beam that passes it
    misfit: float = Field(2.0, gt=0.0, le=100.0)  # mean chi-square of its beams at most
    max_sigma_m: float = Field(0.15, gt=0.0, le=1.0)
    covariance: Literal["lines", "sensor"] = "lines"  # paper: "sensor", constant sigmas of range and bearing (IV)
    floor_share: float = Field(0.02, ge=0.0, le=1.0)  # least sigma of a corner, as a share of the range's sigma
    door_width_m: Limits = (0.6, 1.95)
    door_range_m: float = Field(3.5, gt=0.0, le=30.0)  # farther, or
    door_incidence_deg: float = Field(60.0, gt=0.0, lt=90.0)  # more from the side, a gap is no sighting of a door
    gaps: GapConfig = GapConfig()

    @property
    def is_constant(self) -> bool:
        """True where every corner has the same covariance."""
        return self.covariance == "sensor"


class PolygonConfig(Settings):
    """III-A.2, the Maximum Empty Convex Polygon, or another spatial structure (VI)."""

    structure: Annotated[str, AfterValidator(STRUCTURE_NAMES.check)] = "mecp"  # or one of STRUCTURE_NAMES
    tolerance_sigmas: float = Field(2.5, ge=0.0, le=10.0)  # paper: none
    check_walls: bool = True  # no polygon that a wall crosses; paper: none
    sites: Literal["posts_too", "corners"] = "posts_too"  # posts where the other corners are too few; paper: "corners"
    crossing_beams: int = Field(3, ge=1, le=100)  # neighbours that end in front of an edge: a wall crosses it
    depth_m: float = Field(0.2, gt=0.0, le=2.0)  # in front of, behind, or off an edge: by more than this; a narrower
    # interval that beams pass is none
    keep_ties: int = Field(2, ge=1, le=4)  # paper: "both of them are considered"
    widest_gap_m: float = Field(2.1, gt=0.0, le=10.0)  # between walls: a door, or one seen from the side; else open

    @property
    def is_ours(self) -> bool:
        """True for a structure of the package."""
        return self.structure in STRUCTURE_NAMES.ours


class DynamicObjectsConfig(Settings):
    """Pedestrians and boxes on floor seen free before, and the landmarks that they leave; paper: a static world."""

    margin_m: float = Field(0.2, ge=0.0, le=2.0)  # a hit this far inside free floor is dynamic, and a new corner nearer
    # to it is ignored; 0: a static world
    beyond_m: float = Field(0.3, ge=0.0, le=5.0)  # beams that all go on this far behind a landmark are evidence against
    # it, and a wall this far on both sides of it
    body_m: float = Field(0.45, ge=0.0, le=5.0)  # beams that end this near to the middle of dynamic ones are so, too


class PanoramaConfig(Settings):
    """Recent scans around the robot, where a scan does not surround it; paper: none, its laser sees all around."""

    use: Literal["blind", "needed", "always", "never"] = "needed"  # blind: for lasers with a blind side
    # needed: and for scans of fewer corners than tell where the robot is (`localisation.least_corners`), and while the
    # pose is searched for
    scans: int = Field(6, ge=1, le=50)  # at most, in the window
    spacing_m: float = Field(1.0, gt=0.0, le=10.0)  # between the poses of two of them, or a turn by half as many rad

    @property
    def spacing_rad(self) -> float:
        """A turn that shows as much that is new as `spacing_m` does."""
        return 0.5 * self.spacing_m


class TrackConfig(Settings):
    """From a corner seen once to a landmark."""

    DERIVED: ClassVar = ("jamb_sightings",)

    sightings: int = Field(3, ge=1, le=20)  # of a corner, and of a door
    few_matches: int = Field(4, ge=0, le=100)  # with fewer landmarks in view one sighting is enough (jambs do not count
    # where predictions are wide); one that is not seen as often as the others before the window ends is removed again
    window_steps: int = Field(10, ge=1, le=1000)  # a track not seen for longer is dropped; to see a room again that was
    # not seen for longer is a loop closure
    gate_m: float = Field(0.1, ge=0.0, le=5.0)  # of a corner from its track, beside its noise
    merge: bool = True  # landmarks of one descriptor that may be one corner are one; paper: none

    @property
    def jamb_sightings(self) -> int:
        """One less for a jamb: the other jamb of its door vouches for it."""
        return max(self.sightings - 1, 1)


class AssociationConfig(Settings):
    """III-B, data association."""

    method: Annotated[str, AfterValidator(METHODS.check)] = "mecp"  # one of METHODS, or one registered
    use_polygons: bool = True
    use_rooms: bool = True
    use_descriptor: bool = True  # paper: none
    use_posts: bool = True  # the posts of doors are landmarks; False: features for doors and rooms only. Paper: False
    paper_S: bool = False  # the polygon gate without the cross-covariance of pose and map; paper: True
    gate_probability: float = Field(0.99995, gt=0.5, lt=1.0)  # measured: at 0.999 recall is 0.98, not 0.99
    descriptor_deg: float = Field(40.0, gt=0.0, le=180.0)
    polygons_per_room: int = Field(32, ge=1, le=1000)
    ignore_near: bool = True  # what is nearer than `ignore_gate` to a landmark is neither old nor new; paper: new
    rival_gap: float = Field(6.0, ge=0.0, le=100.0)  # NIS by which a second choice must be worse, 95 %; paper: none
    sharp_sigma_m: float = Field(0.1, gt=0.0, le=10.0)  # of the predicted position, and by the heading of what is a
    # metre away; above, there are two passes, and the update is iterated
    search_budget: int = Field(100_000, ge=1, le=100_000_000)  # nodes that jcbb and ccda try at most in a scan; then
    # the best set of pairs so far counts

    @cached_property
    def ignore_gate(self) -> float:
        """NIS of a corner and a landmark; twice the gate, as a landmark is that near by chance."""
        return 2.0 * chi2_of_point(self.gate_probability) if self.ignore_near else 0.0

    @cached_property
    def face_turn_rad(self) -> float:
        """The most by which a face may turn: any turn where descriptors are not used."""
        return math.radians(self.descriptor_deg) if self.use_descriptor else math.pi

    def is_sharp(self, belief: Belief) -> bool:
        """True while the pose is so well known that one linearisation is enough."""
        (x, _, _), (_, y, _), (_, _, heading) = belief.pose_cov.tolist()
        known: bool = max(x, y) < self.sharp_sigma_m**2
        return known and heading < self.sharp_sigma_m**2


class FilterConfig(Settings):
    """The filter (paper: EKF-SLAM, "ekf")."""

    kind: Annotated[str, AfterValidator(KINDS.check)] = "riekf_submaps"  # riekf, ekf, fej, or one registered
    prior_sigma_m: float = Field(1e-5, gt=0.0, le=10.0)  # of the start, and of the distance of merged landmarks
    prior_sigma_rad: float = Field(1e-6, gt=0.0, le=3.0)
    bumper_lateral_sigma_m: float = Field(0.05, ge=0.0, le=1.0)
    bumper_heading_sigma_deg: float = Field(3.0, ge=0.0, le=90.0)
    second_order: bool = True  # what one linearisation neglects counts as noise of every corner; paper: none
    update_iterations: int = Field(8, ge=1, le=20)  # of the update with a scan, at most; paper: 1
    max_landmarks: int = Field(2048, ge=8, le=10_000)
    submap: int = Field(60, ge=10, le=10_000)  # most landmarks in one; a map of up to six times as many stays whole
    diverged_sigma_m: float = Field(5.0, gt=0.0, le=1000.0)


class LocalisationConfig(Settings):
    """A wrong pose is noticed, and the right one found again without a prior; paper: none."""

    explained_share: float = Field(0.65, ge=0.0, lt=1.0)  # of the beams in mapped space, and of all, at least; of the
    # corners, too, where failed odometry does not explain the pose; 0: never
    scans: int = Field(2, ge=1, le=1000)  # in a row that contradict the map, before the pose is searched for; that
    # confirm a pose that was found
    least_corners: int = Field(4, ge=3, le=100)  # that lie on landmarks there
    margin: int = Field(2, ge=1, le=100)  # more of them than at any other pose
    inlier_m: float = Field(0.15, gt=0.0, le=2.0)  # of a corner from its landmark; half of it for distances in pairs
    weight: float = Field(20.0, ge=0.0, le=1000.0)  # log-odds of the pose for one share of beams instead of none
    most_hypotheses: int = Field(300, ge=1, le=10_000)
    error_m: float = Field(0.5, gt=0.0, le=10.0)  # `confidence` is the probability of a smaller position error

    @property
    def sure(self) -> float:
        """Log-odds of a pose after a scan all of whose beams agree; no scans make it surer."""
        return self.weight * (1.0 - self.explained_share)


class RoomConfig(Settings):
    """III, rooms and doors."""

    doorway_m: float = Field(0.3, ge=0.0, le=2.0)  # the robot is in a doorway up to here, behind it in the other room
    recognise_corners: int = Field(3, ge=1, le=100)  # of another room, seen from two places, that merge rooms
    trail_places: int = Field(512, ge=2, le=100_000)  # of the robot's path, that are kept at most


class GridConfig(Settings):
    """The semantic grid."""

    resolution_m: float = Field(0.1, ge=0.02, le=1.0)
    key_scan_m: float = Field(0.5, gt=0.0, le=10.0)  # a view from farther is another one: a key scan where no other of
    # the room lies as near, and the second sign of another room
    paint_range_m: float = Field(8.0, gt=0.0, le=100.0)
    occupied_ratio: float = Field(0.34, gt=0.0, le=1.0)  # a cell is a wall when this share of the votes says so
    anchors: int = Field(4, ge=2, le=16)  # landmarks that carry a key scan along when the map moves


class SlamConfig(Settings):
    """The whole estimator; the defaults are ours, `SlamConfig.paper()` is the letter of the paper."""

    sensor: SensorModel = SensorModel()
    clustering: ClusteringConfig = ClusteringConfig()
    segments: SegmentConfig = SegmentConfig()
    corners: CornerConfig = CornerConfig()
    polygon: PolygonConfig = PolygonConfig()
    panorama: PanoramaConfig = PanoramaConfig()
    dynamic_objects: DynamicObjectsConfig = DynamicObjectsConfig()
    tracks: TrackConfig = TrackConfig()
    association: AssociationConfig = AssociationConfig()
    localisation: LocalisationConfig = LocalisationConfig()
    filter: FilterConfig = FilterConfig()
    rooms: RoomConfig = RoomConfig()
    grid: GridConfig = GridConfig()

    @classmethod
    def paper(cls) -> Self:
        """The estimator to the letter of the paper (docs/paper.md, by statement); what the paper leaves open is ours.

        The search for polygons finds the region that III-A.2 defines; `polygon.structure="dobkin"` is its algorithm.
        """
        return cls(
            sensor=SensorModel(range_sigma_m=0.05, bearing_sigma_deg=0.3),  # IV: "assumed", whatever the laser has
            clustering=ClusteringConfig(threshold="adaptive", sweeps="union"),  # III-A.1: d / cos(85 deg), no noise
            segments=SegmentConfig(merge_gain=0.0, shift_beams=0, pillar_radius_m=0.0),  # Ramer-Douglas-Peucker alone
            corners=CornerConfig(
                short_faces=False,  # two lines or an end
                covariance="sensor",  # IV: constant sigmas
                door_width_m=(0.75, 1.05),  # III: one width, as a scan measures it
            ),
            # III-A.2: exact
            polygon=PolygonConfig(tolerance_sigmas=0.0, check_walls=False, sites="corners", widest_gap_m=1.2),
            panorama=PanoramaConfig(use="never"),
            dynamic_objects=DynamicObjectsConfig(margin_m=0.0),  # a static world
            tracks=TrackConfig(sightings=1, merge=False),  # augmented at once; a gap of door width is a door (III)
            association=AssociationConfig(
                method="mecp_paper",  # III-B: eq. 3, two vertices by NIS, the rest implicitly
                use_descriptor=False,
                use_posts=False,  # IV: "we do not consider the end points of the door as a feature"
                gate_probability=0.99,  # our choice: the paper names none
                ignore_near=False,  # what matches nothing is new
                rival_gap=0.0,  # the best match counts, however near the second is
                paper_S=True,  # eq. 3 beside the pose, without their cross-covariance
            ),
            filter=FilterConfig(kind="ekf", update_iterations=1, second_order=False),  # standard EKF-SLAM
            localisation=LocalisationConfig(explained_share=0.0),  # the pose is always right
        )
