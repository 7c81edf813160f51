"""The associators that `mecp` is compared with: against exhaustive search, and in closed loop."""

import itertools
import math

import numpy as np
import pytest

from mecp_env.lab.rivals import add_pair, branch_and_bound, predicted_measurements, sorted_choices
from mecp_env.slam.association import make_associator
from mecp_env.slam.association.cliques import (
    ANY_HEADING,
    candidate_pairs,
    cartesian,
    constraint_graph,
    maximum_clique,
    relations,
)
from mecp_env.slam.association.gating import chi2_gate
from mecp_env.slam.config import AssociationConfig, FilterConfig, SlamConfig
from mecp_env.slam.filters import make_filter
from mecp_env.slam.messages import UNKNOWN_ROOM, Decision, FeatureState, Reason
from tests.slam import make
from tests.slam.drives import share_right
from tests.slam.make import polar

RIVALS = ("jcbb", "ccda", "joint_descriptor", "nearest_room", "nearest_descriptor")
MANY = 10**6
FACES = (0.0, 1.5)  # rad, normals of the two faces of every corner
WHOLE_TURN = 2.0 * np.pi
WIDE = (2.0, 2.0, 0.4)  # m, m, rad
APART = np.array([9.0, 0.0])
SHAPE = np.array([[3.0, 0.2], [1.1, 3.4], [-2.3, 1.7], [-1.2, -2.6], [2.2, -1.9]])


class Scene:
    """Landmarks around a robot whose pose is known to `sigma` m and rad, off by `error` of them, and corners seen."""

    def __init__(self, rng, landmarks=6, spurious=1, sigma=0.05, p_robot=None):
        self.rng = rng
        p_robot = rng.uniform(-6.0, 6.0, (landmarks, 2)) if p_robot is None else np.array(p_robot)
        n, exact, self.turned = len(p_robot), np.array([0.01, 0.003]), 0.0
        self.belief = make_filter(FilterConfig(kind="riekf"))
        self.belief.augment(polar(p_robot), np.diag(np.tile(exact, n) ** 2), np.arange(n))
        error = rng.normal(size=3) * sigma * (1.0, 1.0, 0.5)
        self.belief.set_pose(error, np.diag([sigma, sigma, 0.5 * sigma]) ** 2)
        seen = np.concatenate([p_robot, rng.uniform(-6.0, 6.0, (spurious, 2))])
        self.true = np.concatenate([np.arange(n), np.full(spurious, -1)])
        z = polar(seen) + rng.normal(size=seen.shape) * exact
        z[:, 1] = np.pi - (np.pi - z[:, 1]) % WHOLE_TURN
        order = np.argsort(z[:, 1])
        self.z, self.true, self.R = z[order], self.true[order], np.diag(np.tile(exact, len(z)) ** 2)

    @property
    def corners(self):
        """What the scan shows: outer corners, all with the same faces, `turned` by so many radians."""
        return make.corners(self.z, cov=self.R, normals=np.array(FACES) + self.turned)

    def associated(self, **fields):
        """The match of an associator."""
        table = make.features(len(self.belief.ids), state=FeatureState.LANDMARK, normals=FACES, convex=1)
        view = make.view(self.belief.belief(), table, self.corners, make.graph(UNKNOWN_ROOM, ()))
        return make_associator(AssociationConfig(**fields)).associate(self.corners, (), view, self.belief)

    def search(self, gate_probability, budget=MANY):
        """What `branch_and_bound` takes, every pair inside its gate a choice."""
        gate, ids = chi2_gate(2, gate_probability), self.belief.ids
        costs = self.belief.individual_nis(self.z, self.corners.R, ids)
        gates = np.array([0.0, *(chi2_gate(2 * k, gate_probability) for k in range(1, len(self.z) + 1))])
        choices = sorted_choices(costs, gate)
        return self.z, self.R, *predicted_measurements(self.belief, ids), choices, gates, budget


def joint_distance(z, R, h, HPH, pairs):
    """nu^T S^-1 nu of pairs (corner, landmark), in plain linear algebra."""
    i, j = np.array(pairs).T
    nu = z[i] - h[j]
    nu[:, 1] = np.arctan2(np.sin(nu[:, 1]), np.cos(nu[:, 1]))
    corner, landmark = (np.ravel(2 * index[:, None] + [0, 1]) for index in (i, j))
    S = HPH[np.ix_(landmark, landmark)] + R[np.ix_(corner, corner)]
    return float(nu.ravel() @ np.linalg.solve(S, nu.ravel()))


def exhaustive(z, R, h, HPH, choices, gates, _):
    """(number of pairs, joint distance) of the best hypothesis, of all that stay inside every gate on their way."""
    best = (0, 0.0)
    for columns in itertools.product(*([-1, *row[row >= 0]] for row in choices)):
        pairs = [(i, j) for i, j in enumerate(columns) if j >= 0]
        if not pairs or len({j for _, j in pairs}) < len(pairs):
            continue
        on_the_way = [joint_distance(z, R, h, HPH, pairs[: k + 1]) for k in range(len(pairs))]
        if all(distance <= gates[k + 1] for k, distance in enumerate(on_the_way)):
            best = max(best, (len(pairs), -on_the_way[-1]))
    return best[0], -best[1]


@pytest.mark.parametrize("seed", range(3))
def test_jcbb_finds_as_many_pairs_at_the_same_distance_as_an_exhaustive_search(seed):
    rng = np.random.default_rng(seed)
    search = Scene(rng, landmarks=5, spurious=seed % 3, sigma=(0.05, 0.5, 1.0)[seed % 3]).search(0.99)
    count, distance = exhaustive(*search)
    found, joint, _ = branch_and_bound(*search)
    pairs = [(i, j) for i, j in enumerate(found.tolist()) if j >= 0]
    assert len(pairs) == count > 0
    assert joint == pytest.approx(distance, rel=1e-9)
    assert joint == pytest.approx(joint_distance(*search[:4], pairs), rel=1e-9)
    assert all(j in search[4][i] for i, j in pairs)
    few, joint, tried = branch_and_bound(*search[:6], 3)  # without budget, the best so far
    assert tried <= 3
    assert sum(few >= 0) <= count
    z, R, h, HPH, *_ = search
    assert add_pair(np.empty((2, 3)), 0, np.zeros((2, 1), np.int64), z, -R, h, 0.0 * HPH) == np.inf  # S is not positive


def random_graph(rng, groups=6, per_group=3, density=0.6):
    """Costs of edges, group and cost of the nodes of a graph none of whose groups has an edge inside."""
    group = np.repeat(np.arange(groups), per_group)
    size = (len(group), len(group))
    joined = (rng.uniform(size=size) < density) & (group[:, None] != group)
    edges = np.triu(np.where(joined, rng.uniform(0.0, 2.0, size), np.inf), 1)
    return edges + edges.T + np.diag(np.full(len(group), np.inf)), group, rng.uniform(0.0, 5.0, len(group))


def exhaustive_clique(edges, group, cost):
    """The largest clique, of equally large ones the cheapest."""

    def total(clique):
        return cost[clique].sum() + sum(edges[a, b] for a, b in itertools.combinations(clique, 2))

    nodes = [[-1, *np.flatnonzero(group == g)] for g in np.unique(group)]
    chosen = ([v for v in clique if v >= 0] for clique in itertools.product(*nodes))
    return max((c for c in chosen if total(c) < np.inf), key=lambda c: (len(c), -total(c)))


@pytest.mark.parametrize("seed", range(3))
def test_ccda_finds_the_clique_of_an_exhaustive_search(seed):
    graph = random_graph(np.random.default_rng(seed), density=(0.3, 0.6, 0.9)[seed % 3])
    found, tried = maximum_clique(*graph, 1, MANY)
    assert sorted(found.tolist()) == exhaustive_clique(*graph)
    assert tried < MANY
    assert maximum_clique(*graph, len(found), MANY)[0].tolist() == found.tolist()
    assert len(maximum_clique(*graph, len(found) + 1, MANY)[0]) == 0  # fewer than the least pairs


def test_distances_and_their_variances_are_those_of_samples():
    rng = np.random.default_rng(22)
    z, A = np.array([[4.0, 3.1], [5.0, -3.0], [2.0, 0.4]]), 0.002 * rng.normal(size=(6, 6))
    cov = A @ A.T
    drawn = rng.multivariate_normal(z.ravel(), cov, 20_000).reshape(-1, 3, 2)
    p = np.stack([drawn[..., 0] * np.cos(drawn[..., 1]), drawn[..., 0] * np.sin(drawn[..., 1])], axis=-1)
    sampled = np.linalg.norm(p[:, :, None] - p[:, None], axis=-1)
    length, direction, variance = relations(*cartesian(z, cov))
    np.testing.assert_allclose(length, sampled.mean(axis=0), atol=1e-3)
    np.testing.assert_allclose(variance, sampled.var(axis=0), rtol=0.05, atol=1e-12)
    off = (p[:, :, None] - p[:, None]).mean(axis=0)
    np.testing.assert_allclose(direction, np.arctan2(off[..., 1], off[..., 0]), atol=1e-3)


def test_of_more_pairs_than_a_search_can_compare_the_cheapest_are_candidates():
    costs = np.array([[1.0, 9.0, 2.0], [3.0, 4.0, 99.0], [5.0, 99.0, 99.0]])
    for budget, pairs in (
        (MANY, [(2, 0), (1, 0), (1, 1), (0, 0), (0, 1), (0, 2)]),
        (8, [(1, 0), (1, 1), (0, 0), (0, 2)]),
    ):
        rows, columns = candidate_pairs(costs, 10.0, budget)
        assert list(zip(rows.tolist(), columns.tolist(), strict=True)) == pairs


def agreeing(scan, of_map, pairs, known=ANY_HEADING, turned=0.0):
    """Which pairs (corner, landmark) of points agree, by `constraint_graph`; all faces look alike, but are turned."""
    cov, (corner, landmark) = 1e-4 * np.eye(2), np.array(pairs).T
    sides = [relations(np.array(p), np.kron(np.eye(len(p)), cov)) for p in (scan, of_map)]
    faces = np.tile(FACES, (len(scan), 1)), np.tile(FACES, (len(of_map), 1)) + turned
    edges = np.empty((len(pairs), len(pairs)))
    constraint_graph(*sides, corner, landmark, faces, tuple(known), 4.0, edges)
    return np.argwhere(np.triu(edges < np.inf)).tolist()


def test_pairs_agree_on_a_heading_that_is_possible_and_turns_the_faces():
    scan, quarter = [[0.0, 0.0], [3.0, 0.0]], [[1.0, 1.0], [1.0, 4.0]]  # the map is turned by 90 degrees
    pairs, right = [(0, 0), (1, 1)], np.pi / 2.0
    for mean, turned, agree in ((right, right, 1), (right, 0.0, 0), (0.0, right, 0), (-right, right, 0)):
        known = make.headings(mean, 0.1, math.radians(40.0))
        assert len(agreeing(scan, quarter, pairs, known, turned)) == agree
    assert len(agreeing(scan, quarter, pairs)) == 1
    assert agreeing(scan, [[1.0, 1.0], [1.0, 4.2]], pairs) == []
    assert agreeing(scan, scan, [(0, 0), (0, 1), (1, 0), (1, 1)]) == [[0, 3], [1, 2]]  # never with one corner twice


@pytest.mark.parametrize("method", RIVALS)
def test_bearings_on_both_sides_of_pi_are_near(method):
    """Behind the robot, where its heading error puts measured and predicted bearing on different sides of the cut."""
    behind = [(-5.0, 0.01), (-3.0, -0.01), (-4.0, 1.0), (-4.0, -1.0), (3.0, 0.0)]
    for seed in range(2):
        scene = Scene(np.random.default_rng(seed), spurious=0, sigma=0.1, p_robot=behind)
        match = scene.associated(method=method)
        assert sorted(match.ids[match.recognised()].tolist()) == [0, 1, 2, 3, 4]
        assert (match.ids == scene.true).all()
        assert (match.nis >= 0.0).all()
    scene.belief = make_filter(FilterConfig(kind="riekf"))  # before anything is mapped
    assert not len(scene.associated(method=method).recognised())


@pytest.mark.parametrize("method", ["jcbb", "ccda", "nearest_room", "mecp_paper"])
def test_in_closed_loop_the_rivals_map_two_rooms(drive, method):
    run = list(drive.run(SlamConfig(association=AssociationConfig(method=method))))
    by_polygon = [int((output.match.reason == int(Reason.POLYGON)).sum()) for _, output, _, _ in run]
    assert [output.match.known >= 0 for _, output, _, _ in run] == [pairs >= 3 for pairs in by_polygon]
    if method == "mecp_paper":
        assert np.count_nonzero(by_polygon) > 20
        assert share_right(run, [Reason.POLYGON])[0] > 0.9
        return
    precision, pairs = share_right(run)
    assert np.hypot(*run[-1][3][:2]) < 0.1
    assert pairs > 300
    assert precision > 0.98 or method == "nearest_room"  # which confuses the two faces of a wall, as `nearest`


def moved(scene: Scene, error: tuple[float, ...], sigmas: tuple[float, ...] = WIDE) -> Scene:
    """The scene, its pose known to `sigmas` (m, m, rad) and off by `error`."""
    scene.belief.set_pose(np.array(error), np.diag(sigmas) ** 2)
    return scene


@pytest.mark.parametrize("seed", range(4))
def test_a_rough_pose_is_found_by_the_distances(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = Scene(rng, landmarks=7, spurious=1)
    match = moved(scene, tuple(rng.normal(size=3) * (1.5, 1.5, 0.3))).associated(method="mecp")
    paired = match.recognised()
    assert match.ids[paired].tolist() == scene.true[paired].tolist()
    assert len(paired) >= 6


def test_of_two_equal_places_none_is_chosen() -> None:
    scene = Scene(np.random.default_rng(2), p_robot=np.concatenate([SHAPE, SHAPE + APART]), spurious=0)
    near = np.isin(scene.true, range(5))
    scene.z, scene.true = scene.z[near], scene.true[near]  # one of the places is in view
    scene.R = scene.R[:10, :10]
    match = moved(scene, (4.5, 0.0, 0.0), (4.0, 4.0, 0.2)).associated(method="mecp")
    assert len(match.recognised()) == 0
    assert (match.decision == Decision.IGNORED).all()
    for x, sigma_m in ((-1.0, 0.7), (2.0, 2.0)):  # the other is too far off, or less likely
        match = moved(scene, (x, 0.0, 0.0), (sigma_m, sigma_m, 0.2)).associated(method="mecp")
        assert match.ids.tolist() == scene.true.tolist()
