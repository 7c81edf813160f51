"""Rigid transforms of the plane are a group, as their matrices are; angles are wrapped to (-pi, pi]."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mecp_env.core.se2 import compose, inverse, to_map, to_robot, wrap_angle

LENGTHS = st.floats(-100.0, 100.0)
EDGES = [sign * angle for sign in (1.0, -1.0) for angle in (0.0, math.pi, math.nextafter(math.pi, 4.0), 3.0 * math.pi)]
ANGLES = st.floats(-1000.0, 1000.0) | st.sampled_from(EDGES)
POSES = st.builds(lambda x, y, heading: np.array([x, y, heading]), LENGTHS, LENGTHS, st.floats(-math.pi, math.pi))
POINTS = st.lists(st.tuples(LENGTHS, LENGTHS), min_size=1, max_size=4).map(np.array)
UNTIMED = settings(deadline=None)  # the first call compiles


def matrix(T):
    c, s = math.cos(T[2]), math.sin(T[2])
    return np.array([[c, -s, T[0]], [s, c, T[1]], [0.0, 0.0, 1.0]])


@UNTIMED
@given(ANGLES)
def test_wrapped_angles_are_in_range_and_point_the_same_way(angle):
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert wrap_angle(math.pi) == wrap_angle(-math.pi) == math.pi
    assert abs(math.remainder(wrapped - angle, 2.0 * math.pi)) < 1e-12


@UNTIMED
@given(POSES, POSES)
def test_poses_are_the_group_of_their_matrices(T_a_b, T_b_c):
    np.testing.assert_allclose(matrix(compose(T_a_b, T_b_c)), matrix(T_a_b) @ matrix(T_b_c), atol=1e-11)
    for T in (compose(T_a_b, inverse(T_a_b)), compose(inverse(T_a_b), T_a_b)):
        np.testing.assert_allclose(T, 0.0, atol=1e-11)


@UNTIMED
@given(POSES, POINTS)
def test_points_are_carried_as_by_the_matrices_and_back(T_map_robot, p_robot):
    homogeneous, p_map = np.column_stack((p_robot, np.ones(len(p_robot)))), to_map(T_map_robot, p_robot)
    np.testing.assert_allclose(p_map, (homogeneous @ matrix(T_map_robot).T)[:, :2], atol=1e-11)
    np.testing.assert_allclose(to_robot(T_map_robot, p_map), p_robot, atol=1e-11)
