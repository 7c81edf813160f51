"""Dense NumPy reference filters, written from the equations: full F, G, H, Joseph form. Slow and simple."""

import numpy as np
from scipy.linalg import expm

from mecp_env.core.carriers import Array, Ints
from mecp_env.core.se2 import compose
from mecp_env.core.sensors import Odometry
from mecp_env.slam.config import FilterConfig
from tests.slam import make

J = np.array([[0.0, -1.0], [1.0, 0.0]])


def rotation(t: float) -> Array:
    """(2,2)"""
    return np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]])


def wrap(angle: Array) -> Array:
    """In [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def expected(x: Array, slots: Array) -> Array:
    """(m,2) range and bearing of landmarks for x = heading, p, l_1, ..."""
    y = (x[3:].reshape(-1, 2)[slots] - x[1:3]) @ rotation(x[0])
    return np.stack([np.hypot(y[:, 0], y[:, 1]), np.arctan2(y[:, 1], y[:, 0])], axis=1)


def exp_map(x: Array, xi: Array) -> Array:
    """exp(xi) x on SE_{N+1}(2), by the matrix exponential of the whole group element."""
    k = (len(x) - 1) // 2
    algebra, chi = np.zeros((k + 2, k + 2)), np.eye(k + 2)
    algebra[:2, :2], algebra[:2, 2:] = xi[0] * J, xi[1:].reshape(k, 2).T
    chi[:2, :2], chi[:2, 2:] = rotation(x[0]), x[1:].reshape(k, 2).T
    moved = expm(algebra) @ chi
    return np.concatenate([[np.arctan2(moved[1, 0], moved[0, 0])], moved[:2, 2:].T.ravel()])


class Twin:
    """State x and covariance P of a filter, order heading, p, l_1, ..."""

    def __init__(self, config: FilterConfig) -> None:
        self.invariant, self.ids = config.kind == "riekf", list[int]()
        self.slip = np.diag([config.bumper_lateral_sigma_m**2, np.radians(config.bumper_heading_sigma_deg) ** 2])
        self.x, self.merge_var = np.zeros(3), config.prior_sigma_m**2
        self.P = np.diag([config.prior_sigma_rad**2, config.prior_sigma_m**2, config.prior_sigma_m**2])
        self.keeps_first, self.first = config.kind == "fej", self.x  # where Jacobians are taken

    def at(self) -> Array:
        """The state at which Jacobians are taken."""
        return self.first if self.keeps_first else self.x

    def move_pose(self, x: Array) -> Array:
        """F (n,n) of the plain error as the pose moves to that of x, which becomes the state."""
        F = np.eye(len(x))
        F[1:3, 0] = J @ (x[1:3] - self.at()[1:3])
        self.x = x
        self.first = np.concatenate([x[:3], self.first[3:]])
        return F

    def retract(self, xi: Array) -> None:
        self.x = exp_map(self.x, xi) if self.invariant else self.x + xi
        self.x[0] = wrap(self.x[0])

    def predict(self, odometry: Odometry) -> None:
        arcs = len(odometry.increments)
        for (d, w), Q in zip(odometry.increments, odometry.cov, strict=True):
            noise = np.zeros((3, 3))  # distance, turn, sideways
            noise[:2, :2] = Q
            if odometry.bumper:
                noise[1, 1] += self.slip[1, 1] / arcs
                noise[2, 2] += self.slip[0, 0] / arcs
            L = np.array([[np.cos(w / 2), -d / 2 * np.sin(w / 2), -np.sin(w / 2)],
                          [np.sin(w / 2), d / 2 * np.cos(w / 2), np.cos(w / 2)], [0, 1, 0]])  # fmt: skip
            R, turn = rotation(self.x[0]), np.array([0.0, 1.0, 0.0])
            step = R @ (d * L[:2, 0])
            moved, G = self.x.copy(), np.zeros((len(self.x), 3))
            moved[0], moved[1:3] = wrap(self.x[0] + w), self.x[1:3] + step
            F = self.move_pose(moved)
            G[0], G[1:3] = turn, R @ L[:2]
            if self.invariant:
                F = np.eye(len(self.x))
                for i in range(1, len(self.x), 2):
                    G[i : i + 2] -= np.outer(J @ self.x[i : i + 2], turn)
            self.P = F @ self.P @ F.T + G @ noise @ G.T

    def jacobian(self, slots: Array) -> Array:
        """H (2m,n)"""
        x = self.at()
        H = np.zeros((2 * len(slots), len(x)))
        R = rotation(x[0])
        for k, slot in enumerate(slots):
            i = 3 + 2 * slot
            d = x[i : i + 2] - x[1:3]
            y, r = R.T @ d, np.hypot(*d)
            A = np.array([[y[0] / r, y[1] / r], [-y[1] / r**2, y[0] / r**2]]) @ R.T
            rows = slice(2 * k, 2 * k + 2)
            H[rows, 1:3], H[rows, i : i + 2] = -A, A
            if not self.invariant:
                H[rows, 0] = -A @ J @ d
        return H

    def innovation(self, z: Array, R: Array, slots: Array) -> tuple[Array, Array]:
        nu, H = z - expected(self.x, slots), self.jacobian(slots)
        nu[:, 1] = wrap(nu[:, 1])
        return nu.ravel(), H @ self.P @ H.T + R

    def update(self, z: Array, R: Array, ids: Ints, iterate: bool = False) -> float:
        """Gauss-Newton with the filter's Jacobian at each state; returns the cost."""
        slots, steps = np.array([self.ids.index(i) for i in ids], np.int64), 20 if iterate else 1
        xi, prior = np.zeros(len(self.x)), self.x
        for _ in range(steps):
            nu, S = self.innovation(z, R, slots)
            H = self.jacobian(slots)
            K, nu = self.P @ H.T @ np.linalg.inv(S), nu + H @ xi
            xi = K @ nu
            self.x = prior.copy()
            self.retract(xi)
        self.join(K, H, R)
        return float(nu @ np.linalg.solve(S, nu))

    def join(self, K: Array, H: Array, R: Array) -> None:
        """P after a correction, in Joseph form."""
        left = np.eye(len(self.x)) - K @ H
        self.P = left @ self.P @ left.T + K @ R @ K.T

    def fuse(self, keep: int, drop: int) -> None:
        """The difference of two landmarks is measured to be zero; nothing says something of the heading."""
        kept, gone = (slice(3 + 2 * self.ids.index(i), 5 + 2 * self.ids.index(i)) for i in (keep, drop))
        H, R = np.zeros((2, len(self.x))), self.merge_var * np.eye(2)
        H[:, kept], H[:, gone] = np.eye(2), -np.eye(2)
        if self.keeps_first:
            H[:, 0] = -J @ (self.first[kept] - self.first[gone])
        K = self.P @ H.T @ np.linalg.inv(H @ self.P @ H.T + R)
        self.retract(-K @ (self.x[kept] - self.x[gone]))
        self.join(K, H, R)
        self.remove(np.array([drop]))

    def remove(self, ids: Ints) -> None:
        kept = np.isin(self.ids, ids, invert=True)
        rows = np.concatenate([np.ones(3, np.bool_), np.repeat(kept, 2)])
        self.x, self.first, self.P = self.x[rows], self.first[rows], self.P[np.ix_(rows, rows)]
        self.ids = np.array(self.ids)[kept].tolist()

    def set_pose(self, T: Array, cov: Array | None = None) -> None:
        world = self.world_cov()
        world[:3], world[:, :3] = 0.0, 0.0
        world[:3, :3] = 1e-12 * np.eye(3) if cov is None else cov
        self.x[:3] = self.first[:3] = T[[2, 0, 1]]
        self.set_world_cov(world)

    def loosen(self, cov: Array) -> None:
        world = self.world_cov()
        world[:3, :3] += cov
        self.set_world_cov(world)

    def shift_pose(self, T: Array) -> None:
        if not self.invariant:
            F = self.move_pose(self.x)
            self.P = F @ self.P @ F.T
        pose, F = self.x[[1, 2, 0]], np.eye(len(self.x))
        F[:3, :3] = make.slopes(lambda x: compose(x, T), pose)
        world = F @ self.world_cov() @ F.T
        self.x[:3] = compose(pose, T)[[2, 0, 1]]
        self.first = np.concatenate([self.x[:3], self.first[3:]])
        self.set_world_cov(world)

    def augment(self, z: Array, R: Array, ids: Ints) -> None:
        n, m = len(self.x), len(z)
        self.ids += ids.tolist()
        if self.keeps_first:
            F = self.move_pose(self.x)
            self.P = F @ self.P @ F.T
        grow, noise = np.zeros((n + 2 * m, n)), np.zeros((n + 2 * m, 2 * m))
        grow[:n] = np.eye(n)
        new = []
        for k, (r, b) in enumerate(z):
            point = self.x[1:3] + r * rotation(self.x[0]) @ [np.cos(b), np.sin(b)]
            rows = slice(n + 2 * k, n + 2 * k + 2)
            grow[rows, 1:3] = np.eye(2)
            if not self.invariant:
                grow[rows, 0] = J @ (point - self.x[1:3])
            Jz = np.array([[np.cos(b), -r * np.sin(b)], [np.sin(b), r * np.cos(b)]])
            noise[rows, 2 * k : 2 * k + 2] = rotation(self.x[0]) @ Jz
            new.append(point)
        self.P = grow @ self.P @ grow.T + noise @ R @ noise.T
        self.x, self.first = np.concatenate([self.x, *new]), np.concatenate([self.first, *new])

    def to_world(self) -> Array:
        """Derivative of x, y, heading, landmarks by the error."""
        T = np.eye(len(self.x))
        if self.invariant:
            T[1:, 0] = (self.x[1:].reshape(-1, 2) @ J.T).ravel()
        return T[np.r_[1, 2, 0, 3 : len(self.x)]]

    def world_cov(self) -> Array:
        """P of world coordinates, order x, y, heading, landmarks."""
        return self.to_world() @ self.P @ self.to_world().T

    def set_world_cov(self, world: Array) -> None:
        from_world = np.linalg.inv(self.to_world())
        self.P = from_world @ world @ from_world.T
