"""Float64 oracles: the paper's equations, and least squares by Levenberg and Marquardt."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from accelcal_cli.core.arithmetic import ONE
from accelcal_cli.core.calibration import IDENTITY, TemperatureScale
from accelcal_cli.core.points import WEIGHT_ONE, Fit, Model, Operations, PointSet

IDEAL = np.array([1.0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0])


def gain(p: np.ndarray) -> np.ndarray:
    """K of eq. 7-9, (..., 3, 3), of parameters (..., 12)."""
    k = np.zeros((*p.shape[:-1], 3, 3))
    k[..., (0, 1, 2, 1, 2, 2), (0, 1, 2, 0, 0, 1)] = p[..., :6]
    return k


def calibrated(p: np.ndarray, v: np.ndarray, tau: np.ndarray | None = None) -> np.ndarray:
    """a = K (v + o + s tau), (..., n, 3), of parameters (..., 12)."""
    u = v + p[..., None, 6:9]
    if tau is not None:
        u = u + tau[:, None] * p[..., None, 9:12]
    return u @ gain(p).swapaxes(-1, -2)


def measured(p: np.ndarray, a: np.ndarray, tau: np.ndarray | None = None) -> np.ndarray:
    """The inverse, F's eq. 19 with its misprint mended."""
    x = a[:, 0] / p[0]
    y = (a[:, 1] - x * p[3]) / p[1]
    z = (a[:, 2] - x * p[4] - y * p[5]) / p[2]
    v = np.stack([x, y, z], axis=1) - p[6:9]
    return v if tau is None else v - np.outer(tau, p[9:12])


def residual(p: np.ndarray, v: np.ndarray, tau: np.ndarray | None = None) -> np.ndarray:
    """|a|^2 - 1, (..., n), of parameters (..., 12)."""
    return (calibrated(p, v, tau) ** 2).sum(axis=-1) - 1


def cost(p: np.ndarray, v: np.ndarray) -> float:
    """Mean of (|a|^2 - 1)^2, eq. 12 without the root."""
    return float((residual(p, v) ** 2).mean())


def paper_descent(v: np.ndarray, iterations: int, h: float = 1e-5) -> list[np.ndarray]:
    """Eq. 13-16 with the published rates; parameters after each iteration."""
    rates = np.array([0.3] * 3 + [0.8] * 3 + [0.2] * 3)
    p, history = IDEAL.copy(), []
    for _ in range(iterations):
        here = cost(p, v)
        slope = np.array([(cost(p + h * one, v) - here) / h for one in np.eye(12)[:9]])
        p = p.copy()
        p[:9] -= rates * slope
        history.append(p)
    return history


def directions(number: int) -> np.ndarray:
    """Unit vectors evenly spread over the sphere."""
    index = np.arange(number) + 0.5
    z, turn = 1 - 2 * index / number, np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)


def random_directions(random: np.random.Generator, number: int) -> np.ndarray:
    """Unit vectors, uniform on the sphere."""
    v = random.standard_normal((number, 3))
    return v / np.sqrt((v**2).sum(axis=1))[:, None]


def drawn_errors(random: np.random.Generator) -> np.ndarray:
    """Parameters by F's eq. 17 and 18."""
    s = 2 * (random.random(3) - 0.5) * 0.1 + 1
    t = 2 * (random.random(3) - 0.5) * 0.05
    o = 2 * (random.random(3) - 0.5) * 0.1
    return np.array([*s, s[1] * t[0], s[2] * t[1], s[2] * t[2], *o, 0, 0, 0])


def points(
    v: np.ndarray,
    *,
    weights: np.ndarray | None = None,
    windows: np.ndarray | None = None,
    tau: np.ndarray | None = None,
    span_c: float = 4.0,
) -> PointSet:
    """Positions in g, weights in points and scaled temperatures as a point set."""
    number = len(v)
    held = np.ones(number) if weights is None else weights
    return PointSet(
        np.rint(np.asarray(v) * ONE).astype(np.int64).reshape(-1, 3),
        np.rint(held * WEIGHT_ONE).astype(np.int64),
        np.ones(number, np.int64) if windows is None else np.asarray(windows, np.int64),
        None if tau is None else np.rint(tau * ONE).astype(np.int64),
        None if tau is None else TemperatureScale(30_000, span_c),
    )


@dataclass(frozen=True)
class LeastSquares:
    """A least-squares optimum and how it was reached."""

    p: np.ndarray
    converged: bool


def jacobian(p: np.ndarray, v: np.ndarray, tau: np.ndarray | None) -> np.ndarray:
    """d residual / dp by central differences: exact to 1e-10 for a cubic in each parameter."""
    step = 1e-4 * np.eye(12)
    return (residual(p + step, v, tau) - residual(p - step, v, tau)).T / 2e-4


def least_squares(held: PointSet, free: tuple[int, ...]) -> LeastSquares:
    """Levenberg-Marquardt on the weighted sum of (|a|^2 - 1)^2."""
    v, root = held.xyz / ONE, np.sqrt(held.weights / WEIGHT_ONE)
    tau = None if held.tau is None else held.tau / ONE
    p, damping, columns = IDEAL.copy(), 1e-3, list(free)
    for _ in range(200):
        r = root * residual(p, v, tau)
        jac = root[:, None] * jacobian(p, v, tau)[:, columns]
        normal = jac.T @ jac
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), -jac.T @ r)
        trial = p.copy()
        trial[columns] += step
        if (root * residual(trial, v, tau)) @ (root * residual(trial, v, tau)) <= r @ r:
            p, damping = trial, damping / 10
        else:
            damping *= 10
        if abs(step).max() < 1e-13 or damping > 1e12:
            break
    return LeastSquares(p, bool(abs(step).max() < 1e-9))


def fast_fit(held: PointSet, model: Model) -> Fit:
    """Least squares as an optimizer, for tests of what comes after it."""
    if not model.free or not len(held):
        return Fit(IDENTITY, 0, "nothing to fit", Operations())
    found = least_squares(held, model.free).p
    return Fit(tuple(round(float(value) * ONE) for value in found), 1, "least squares", Operations())


def one_by_one(fit: Callable[[PointSet, Model], Fit]) -> Callable[[Sequence[PointSet], Model], list[Fit]]:
    """An optimizer as the judge takes it."""
    return lambda sets, model: [fit(held, model) for held in sets]


fast_fits = one_by_one(fast_fit)
