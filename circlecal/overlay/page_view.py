"""A view and its uncertainty as numbers for the script of a page, which answers under the pointer without a server.

The script is ``camera.js`` among the assets of the report; the workbench shares it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from circlecal.field.view import FieldView
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array

GRID = (32, 18)
"""Columns and rows of the places at which the standard deviation is told; it changes slowly over a picture."""


def describe_view(view: FieldView) -> dict[str, Any]:
    """What takes pixels to metres, ready for JSON: camera, lens and surface, or a homography from pixels to metres."""
    camera = view.camera
    if not isinstance(camera, Camera):
        to_field = np.linalg.inv(camera.homography)
        return {"homography": (to_field * (np.sign(np.linalg.det(to_field)) or 1.0)).tolist()}
    return {
        "width": camera.width,
        "focal": camera.focal_px.tolist(),
        "principal": camera.principal_point_px.tolist(),
        "R": camera.R.tolist(),
        "position": camera.position_m.tolist(),
        "kappa": camera.kappa.tolist(),
        "shape": view.surface.shape,
        "crown": view.surface.crown_m,
        "reference": view.surface.reference_m,
    }


def cell_centers(view: FieldView, columns: int, rows: int) -> Array:
    """Middles (rows, columns, 2) of the cells of a grid over the whole picture, pixels: it begins half a pixel before
    the middle of the first one.
    """
    size = np.array([view.camera.width, view.camera.height])
    cells = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
    return np.asarray((cells + 0.5) * size / (columns, rows) - 0.5)


def sigma_grid(view: FieldView, grid: tuple[int, int] = GRID) -> dict[str, Any] | None:
    """Standard deviations at the centres of a grid over the picture, px and m, row by row; None where not known.

    Parameters
    ----------
    view : FieldView
        The view.
    grid : (2,) tuple of int
        Columns and rows.

    Returns
    -------
    dict or None
        ``columns``, ``rows``, and the lists ``px`` and ``m``, in which None stands above the horizon.
    """
    columns, rows = grid
    on_ground = view.to_field(cell_centers(view, columns, rows).reshape(-1, 2), sigma=True)
    in_picture = view.project(on_ground.points, sigma=True).sigma
    if on_ground.sigma is None or in_picture is None:
        return None
    return {
        "columns": columns,
        "rows": rows,
        "px": [_round(v) for v in in_picture.tolist()],
        "m": [_round(v) for v in on_ground.sigma.tolist()],
    }


def _round(value: float) -> float | None:
    return float(f"{value:.3g}") if np.isfinite(value) else None
