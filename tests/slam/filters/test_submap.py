"""A filter that works on a submap against the same filter without one, on drives through a field of landmarks."""

import numpy as np
import pytest

from mecp_env.core.se2 import compose, wrap_angle
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import RightInvariantEkf, SubmapEkf
from mecp_env.slam.filters.submap import near_any
from mecp_env.slam.protocols import FilterError, FullFilterWarning
from tests.slam import make

FIELD = np.random.default_rng(0).uniform(-3.0, 33.0, (320, 2))
WAY = [(30.0, 0.0), (30.0, 7.0), (0.0, 7.0), (0.0, 14.0), (30.0, 14.0), (30.0, 21.0), (0.0, 21.0), (0.0, 0.0)]
MOST = 35
RANGE_M, NOISE = 5.0, np.array([0.01, 0.002])
DRIVEN = np.array([0.005, 0.003])
MARKS = np.array([[10.0, 0.0], [10.0, 1.5]])  # of a pose, as seen from it
SHARP = 3e-4  # m and rad, of a scan that is registered with a past one
LOOSE, SHIFT = np.diag([0.1, 0.2, 0.05]) ** 2, np.array([0.02, 0.01, 0.03])


class Drive:
    """A robot that goes along the way twice, and filters that all get the same measurements."""

    def __init__(self, *filters, seed=0):
        self.filters, self.rng = filters, np.random.default_rng(seed)
        self.T, self.at, self.known = np.zeros(3), 0, set()

    def step(self, iterate=False):
        target = np.array(WAY[self.at % len(WAY)])
        self.at += np.hypot(*(target - self.T[:2])) < 1.0
        away = target - self.T[:2]
        turn = np.clip(wrap_angle(np.arctan2(away[1], away[0]) - self.T[2]), -0.3, 0.3)
        move = np.array([[0.4, turn]])
        self.T = compose(self.T, np.array([0.4 * np.cos(turn / 2.0), 0.4 * np.sin(turn / 2.0), turn]))
        odometry = make.odometry(move + DRIVEN * self.rng.standard_normal((1, 2)), DRIVEN)
        near = np.flatnonzero(np.hypot(*(FIELD - self.T[:2]).T) < RANGE_M)
        old, new = (np.array([i for i in near if (i in self.known) == seen], np.int64) for seen in (True, False))
        for some in self.filters:
            some.predict(odometry)
        for ids, name in ((old, "update"), (new, "augment")):
            seen = self.look(ids)
            for some in self.filters if len(ids) else ():
                some.update(*seen, ids, iterate) if name == "update" else some.augment(*seen, ids)
        self.known |= {i for i in new.tolist() if self.filters and self.filters[0].has(i)}

    def look(self, ids):
        d = FIELD[ids] - self.T[:2]
        z = np.stack([np.hypot(*d.T), np.arctan2(d[:, 1], d[:, 0]) - self.T[2]], axis=1)
        z += NOISE * self.rng.standard_normal(z.shape)
        z[:, 1] = [wrap_angle(bearing) for bearing in z[:, 1]]
        return z, np.diag(np.tile(NOISE**2, len(ids)))


def driven(steps, **fields):
    """A drive of so many steps with both filters."""
    config = FilterConfig(submap=MOST, **fields)
    drive = Drive(RightInvariantEkf(config), SubmapEkf(config))
    for _ in range(steps):
        drive.step()
    return drive, *drive.filters


@pytest.fixture(scope="module")
def long_drive():
    """The submap was taken anew several times."""
    drive, whole, divided = driven(460)
    assert divided.rest is not None
    assert len(divided.slot_ids) < 7 * MOST
    return drive, whole, divided


def test_what_is_asked_of_landmarks_at_rest_is_exact(long_drive):
    drive, whole, divided = long_drive
    ids = np.concatenate(
        (divided.rest.slot_ids[divided.rest.at_work][:2], divided.rest.belief.ids[divided.rest.is_at_rest][:3])
    )
    for of_whole, of_divided in zip(whole.marginal(ids), divided.marginal(ids), strict=True):
        assert np.abs(of_whole - of_divided).max() < 1e-9
    z, R = drive.look(ids)
    for of_whole, of_divided in zip(whole.innovation(z, R, ids), divided.innovation(z, R, ids), strict=True):
        assert np.abs(of_whole - of_divided).max() < 1e-8
    assert np.isclose(whole.joint_nis(z, R, ids), divided.joint_nis(z, R, ids), rtol=1e-6)
    assert np.isclose(whole.mean_of_gaussians_nis(z, R, ids), divided.mean_of_gaussians_nis(z, R, ids), rtol=1e-6)


def test_every_pair_inside_a_gate_is_found(long_drive):
    drive, whole, divided = long_drive
    near = np.flatnonzero(np.hypot(*(FIELD - drive.T[:2]).T) < 2.0 * RANGE_M)
    z, _ = drive.look(near[np.isin(near, whole.ids)])
    blocks = np.broadcast_to(np.diag(NOISE**2), (len(z), 2, 2))
    expected, found = (some.individual_nis(z, blocks, whole.ids) for some in (whole, divided))
    inside = expected < 20.0
    assert inside.sum() >= len(z) - 2
    assert np.allclose(found[inside], expected[inside], rtol=1e-6)
    assert (found[~inside] > 19.9).all()


def test_the_belief_names_all_landmarks_and_is_exact_for_those_in_the_submap(long_drive):
    _, whole, divided = long_drive
    expected, shown = whole.belief(), divided.belief()
    assert np.array_equal(shown.ids, expected.ids)
    assert np.array_equal(divided.ids, expected.ids)
    at_work = np.isin(shown.ids, divided.slot_ids)
    assert 10 < at_work.sum() <= MOST
    assert np.abs(shown.p_map - expected.p_map)[at_work].max() < 1e-9
    assert np.abs(shown.covs - expected.covs)[at_work].max() < 1e-9
    assert np.abs(shown.p_map - expected.p_map).max() < 0.05  # as they were a while ago
    assert np.abs(shown.T_map_robot - expected.T_map_robot).max() < 1e-9


def test_a_small_map_is_that_of_the_whole_filter_to_the_bit():
    drive, whole, divided = driven(0)
    while whole.count < 6 * MOST - 20:
        drive.step()
    assert divided.rest is None
    assert np.array_equal(whole.state, divided.state)


def test_unknown_ids_are_refused_and_the_map_may_be_full(long_drive):
    drive, _, divided = long_drive
    z, R = drive.look(np.array([0]))
    for call in (divided.update, divided.innovation, divided.joint_nis):
        with pytest.raises(FilterError, match="no landmarks of this filter"):
            call(z, R, np.array([10**6]))
    with pytest.raises(FilterError, match="must be new"):
        divided.augment(z, R, divided.rest.belief.ids[divided.rest.is_at_rest][:1])
    with pytest.warns(FullFilterWarning) as warned:
        _, whole, divided = driven(460, max_landmarks=220)
    assert len(warned) == 2  # one of each filter
    assert whole.dropped == divided.dropped > 0
    assert len(divided.ids) == 220


def test_landmarks_that_may_be_seen_are_those_within_five_sigmas():
    rng = np.random.default_rng(6)
    p_map, seen = rng.uniform(0.0, 10.0, size=(80, 2)), rng.uniform(0.0, 10.0, size=(5, 2))
    variance, seen_variance, asked = rng.uniform(0.0, 0.02, 80), rng.uniform(0.0, 0.02, 5), rng.random(80) < 0.7
    apart = np.hypot(*(p_map[:, None] - seen).transpose(2, 0, 1))
    within = apart < 5.0 * np.sqrt(2.0 * (variance[:, None] + seen_variance))
    found = near_any(p_map, variance, asked, seen, seen_variance)
    assert np.array_equal(found, within.any(axis=1) & asked)
    assert 5 < found.sum() < asked.sum()


class Ordeal(Drive):
    """A drive with marks of past poses that are seen sharply, lost poses, and landmarks that go and that are one."""

    def __init__(self, *filters, seed):
        super().__init__(*filters, seed=seed)
        self.marks, self.next_mark, self.next_double = [], -2, 10**6

    def step(self, iterate=False):
        super().step(iterate)
        self.mark()
        self.register()
        rare = (0.004, self.lose_pose), (0.01, self.loosen), (0.01, self.forget), (0.01, self.double), (0.02, self.copy)
        for chance, happen in rare:
            if self.rng.random() < chance and len(self.known) > 20:
                happen()

    def each(self, name, *arguments):
        return [getattr(some, name)(*arguments) for some in self.filters]

    def mark(self):
        """Every fourth step has marks; four poses have them at once."""
        if self.rng.random() < 0.25:
            self.marks.append(np.array([self.next_mark, self.next_mark - 1]))
            self.next_mark -= 2
            self.each("augment", MARKS, np.eye(4) * 1e-7, self.marks[-1])
        if len(self.marks) > 4:
            self.each("remove", self.marks.pop(0))

    def register(self):
        """See the newest marks where the first filter believes them to be, as it has no other truth of them."""
        if self.marks and self.rng.random() < 0.3:
            mean, _ = self.filters[0].marginal(self.marks[-1])
            away = mean[3:].reshape(2, 2) - mean[:2]
            z = np.stack([np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0]) - mean[2]], axis=1)
            z += SHARP * self.rng.standard_normal((2, 2))
            z[:, 1] = [wrap_angle(bearing) for bearing in z[:, 1]]
            self.each("update", z, np.eye(4) * SHARP**2, self.marks[-1])

    def lose_pose(self):
        self.each("set_pose", self.filters[0].belief().T_map_robot, np.diag([0.3, 0.3, 0.05]) ** 2)

    def loosen(self):
        self.each("loosen", LOOSE)
        self.each("shift_pose", SHIFT)

    def forget(self):
        gone = np.array([self.rng.choice(sorted(self.known))])
        self.known -= set(gone.tolist())
        self.each("remove", gone)

    def double(self):
        """A landmark is taken for a new one, seen three times more, and then recognised."""
        near = [i for i in self.known if np.hypot(*(FIELD[i] - self.T[:2])) < 5.0]
        for old in near[:1]:
            again = np.array([self.next_double])
            self.next_double += 1
            self.each("augment", *self.look(np.array([old])), again)
            for _ in range(3):
                self.each("update", *self.look(np.array([old])), again)
            self.each("fuse", old, int(again[0]))

    def copy(self):
        self.filters = tuple(self.each("copy"))


@pytest.mark.parametrize("seed", [1, 2])
def test_no_digits_are_lost_by_whatever_happens(seed):
    """A covariance in terms of bare numbers lost so many that the filter ended after 16,929 steps in `50015848`."""
    config = FilterConfig(submap=30)
    drive = Ordeal(RightInvariantEkf(config), SubmapEkf(config), seed=seed)
    for step in range(450):
        drive.step()
        if step % 50 == 0:
            whole, divided = (set(belief.ids.tolist()) for belief in drive.each("belief"))
            assert whole == divided
            assert min(whole) >= 0  # marks are no landmarks
    whole, divided = drive.filters
    divided.synchronise()
    assert set(divided.slot_ids.tolist()) == set(whole.slot_ids.tolist())
    for expected, found in zip(whole.marginal(whole.slot_ids), divided.marginal(whole.slot_ids), strict=True):
        assert np.abs(found - expected).max() < 1e-10
