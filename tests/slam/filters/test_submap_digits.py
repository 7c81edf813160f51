"""A long drive on small submaps, with everything that may happen to a filter, loses no digits against the whole one."""

import numpy as np
import pytest

from mecp_env.core.se2 import wrap_angle
from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters import RightInvariantEkf, SubmapEkf
from tests.slam.filters.test_submap import FIELD, Drive

MARKS = np.array([[10.0, 0.0], [10.0, 1.5]])  # of a pose, as seen from it
SHARP = 3e-4  # m and rad, of a scan that is registered with a past one
LOOSE = np.diag([0.1, 0.2, 0.05]) ** 2


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
