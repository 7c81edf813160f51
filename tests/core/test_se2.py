"""Rigid transforms of the plane obey the group axioms; angles are wrapped to (-pi, pi]."""

import math

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mecp_env.core.se2 import compose, inverse, to_map, to_robot, wrap_angle

LENGTHS = st.floats(-100.0, 100.0)
ANGLES = st.floats(-1000.0, 1000.0)
POSES = st.builds(lambda x, y, heading: np.array([x, y, heading]), LENGTHS, LENGTHS, st.floats(-math.pi, math.pi))
POINTS = st.lists(st.tuples(LENGTHS, LENGTHS), min_size=1, max_size=4).map(np.array)
UNTIMED = settings(deadline=None)  # the first call compiles


def assert_same_pose(one, other):
    np.testing.assert_allclose(one[:2], other[:2], atol=1e-11)
    assert abs(math.remainder(one[2] - other[2], 2.0 * math.pi)) < 1e-13


def matrix(T):
    c, s = math.cos(T[2]), math.sin(T[2])
    return np.array([[c, -s, T[0]], [s, c, T[1]], [0.0, 0.0, 1.0]])


@UNTIMED
@given(ANGLES)
@example(math.pi)
@example(-math.pi)
@example(math.nextafter(math.pi, 4.0))
@example(math.nextafter(-math.pi, -4.0))
@example(3.0 * math.pi)
@example(-3.0 * math.pi)
@example(0.0)
def test_wrapped_angles_are_in_range_and_point_the_same_way(angle):
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert wrap_angle(math.pi) == wrap_angle(-math.pi) == math.pi
    assert abs(math.remainder(wrapped - angle, 2.0 * math.pi)) < 1e-12
    assert abs(math.remainder(wrap_angle(wrapped) - wrapped, 2.0 * math.pi)) < 1e-15


@UNTIMED
@given(POSES, POSES, POSES)
def test_poses_are_a_group_and_its_product_is_that_of_the_matrices(T_a_b, T_b_c, T_c_d):
    assert_same_pose(compose(compose(T_a_b, T_b_c), T_c_d), compose(T_a_b, compose(T_b_c, T_c_d)))
    np.testing.assert_allclose(matrix(compose(T_a_b, T_b_c)), matrix(T_a_b) @ matrix(T_b_c), atol=1e-11)
    for one, other in ((np.zeros(3), T_a_b), (T_a_b, np.zeros(3))):
        assert_same_pose(compose(one, other), T_a_b)
    for one, other in ((T_a_b, inverse(T_a_b)), (inverse(T_a_b), T_a_b)):
        assert_same_pose(compose(one, other), np.zeros(3))


@UNTIMED
@given(POSES, POSES, POINTS)
def test_points_are_carried_as_by_the_matrices(T_map_robot, T_robot_laser, p_laser):
    p_map = to_map(T_map_robot, to_map(T_robot_laser, p_laser))
    np.testing.assert_allclose(p_map, to_map(compose(T_map_robot, T_robot_laser), p_laser), atol=1e-11)
    np.testing.assert_allclose(to_robot(T_map_robot, to_map(T_map_robot, p_laser)), p_laser, atol=1e-11)
    np.testing.assert_allclose(to_robot(T_map_robot, p_laser), to_map(inverse(T_map_robot), p_laser), atol=1e-11)
    homogeneous = np.column_stack((p_laser, np.ones(len(p_laser))))
    np.testing.assert_allclose(
        to_map(T_robot_laser, p_laser), (homogeneous @ matrix(T_robot_laser).T)[:, :2], atol=1e-11
    )
