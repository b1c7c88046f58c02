"""Checks of the arguments of a ball's fit; every fault raises InputError with what to do."""

import numpy as np

from sensors.ball.solve import LOSSES, Problem
from workbench.core.errors import InputError


def problem_of(points, sigma, radius, covariance, direction) -> Problem:
    """The `Problem` of points (3, n) mm with the sigma, covariance or direction of their errors."""
    if points.ndim != 2 or len(points) != 3:
        raise InputError(
            f"points: expected an array of shape (3, n), found {points.shape}; "
            "hand over one point a column"
        )
    n = points.shape[1]
    if covariance is not None and (direction is not None or sigma is not None):
        raise InputError(
            "points: expected sigma (with or without direction) or covariance, found both; leave one out"
        )
    if covariance is not None:
        covariance = np.broadcast_to(np.reshape(covariance, (3, 3, -1)), (3, 3, n))
        sigma = np.sqrt(np.einsum("ddn->n", covariance) / 3)
    sigma = np.broadcast_to(1.0 if sigma is None else np.asarray(sigma, float), (n,))
    return Problem(
        points, sigma, covariance, unit_vectors(direction, points, "direction"), radius is None
    )


def unit_vectors(vectors, points, called):
    """(3, n) unit vectors of one or n, None for None."""
    if vectors is None:
        return None
    vectors = np.asarray(vectors, float)
    if len(vectors) != len(points) or vectors.size not in (len(points), points.size):
        raise InputError(
            f"{called}: expected one vector or one a point, found shape {vectors.shape}; "
            "hand over one vector a column"
        )
    vectors = np.broadcast_to(vectors.reshape(len(points), -1), points.shape)
    return vectors / np.linalg.norm(vectors, axis=0)


def check_options(radius, incidence, edge, loss, view, groups, shared) -> None:
    """Raise InputError where options of `fit_ball` contradict one another or are out of range."""
    if groups is not None and shared is not None:
        raise InputError(
            "groups: expected groups or shared errors of known covariance, found both; leave one out"
        )
    if radius is not None and not 0 < radius < np.inf:
        raise InputError(
            f"radius: expected a positive length in mm, found {radius}; measure the ball again"
        )
    if loss not in LOSSES:
        raise InputError(
            f"loss: expected one of {', '.join(LOSSES)}, found '{loss}'; choose one of them"
        )
    if view is None and (incidence is not None or edge):
        raise InputError(
            "view: expected the direction in which the sensor looks, found none; "
            "it is needed to trim by incidence or edge"
        )


__all__ = ["check_options", "problem_of", "unit_vectors"]
