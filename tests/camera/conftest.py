"""Cameras and parameter vectors that the tests of the fit share."""

import numpy as np

from circlecal.geometry.camera_parameters import INDEX, PARAMETERS


def random_thetas(count: int, rng: np.random.Generator) -> np.ndarray:
    """Main cameras (count, P) that see the centre circle, every parameter away from its neutral value."""
    theta = np.zeros((count, len(PARAMETERS)))
    position = np.stack([rng.uniform(-15, 15, count), rng.uniform(45, 80, count), rng.uniform(-25, -8, count)], axis=-1)
    theta[:, 0] = np.log(rng.uniform(1800, 4500, count))
    theta[:, 1] = np.arctan2(-position[:, 0], position[:, 1]) + rng.normal(0, 0.03, count)
    theta[:, 2] = np.arctan2(np.hypot(position[:, 0], position[:, 1]), -position[:, 2]) + rng.normal(0, 0.02, count)
    theta[:, 3] = rng.normal(0, 0.03, count)
    theta[:, 4:7] = position
    theta[:, 7:9] = rng.normal(0, 8, (count, 2))
    theta[:, 9] = rng.uniform(0.01, 0.05, count)
    theta[:, 10] = rng.uniform(-0.01, 0.01, count)
    theta[:, INDEX["log_aspect"]] = rng.normal(0, 0.05, count)
    theta[:, INDEX["crown"]] = rng.uniform(0.03, 0.1, count)
    theta[:, INDEX["width"]] = rng.normal(0, 0.01, count)
    theta[:, INDEX["bloom"]] = rng.normal(0, 0.2, count)
    theta[:, INDEX["length"]] = rng.normal(0, 1, count)
    theta[:, INDEX["breadth"]] = rng.normal(0, 1, count)
    return theta


def central_differences(function, theta: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Derivative (..., P) of ``function(theta)`` (...,) for one parameter vector (P,), fourth order in the step."""
    columns = []
    for k, step in enumerate(steps):
        shift = np.zeros_like(theta)
        shift[k] = step
        near = function(theta + shift) - function(theta - shift)
        far = function(theta + 2 * shift) - function(theta - 2 * shift)
        columns.append((8 * near - far) / (12 * step))
    return np.stack(columns, axis=-1)


STEPS = np.array([1e-4] * 4 + [1e-2] * 3 + [1e-1] * 2 + [1e-4, 1e-6] + [1e-4, 1e-3, 1e-4, 1e-2, 1e-2, 1e-2])
"""Step of each parameter."""
