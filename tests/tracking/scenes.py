"""A tripod before a drawn pitch, for tests that need no renderer."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.field import FieldTemplate, load_field
from circlecal.geometry.surface import Surface
from circlecal.rig.tripod import COMMON, PLACE, TripodEstimate
from circlecal.tracking.frame_paint import HeadedFrame
from circlecal.tracking.markings import SPACING_PX, place_markings, template_curves
from circlecal.tracking.seen_paint import MeasuredFrame

SIZE = (1280, 720)
HEAD = np.array([np.log(1500.0), -0.35, 1.38])
"""Sees a penalty area from the tripod of :func:`tripod`."""


def template() -> FieldTemplate:
    return load_field("soccer")


def tripod() -> TripodEstimate:
    common = np.zeros(len(COMMON))
    common[:3], common[PLACE["lever"]], common[PLACE["kappa_1"]] = [1.0, 85.0, -16.0], 0.8, 0.02
    common[PLACE["lean_x"]], common[PLACE["crown"]] = 0.005, 0.04
    sd = np.zeros(len(COMMON))
    sd[:3] = 0.01
    return TripodEstimate(
        "camera-1", SIZE, float(np.log(1500.0)), Surface("roof", 9.15, 0.04), common, np.diag(sd**2),
        HEAD - np.array([0.1, 0.3, 0.03]), HEAD + np.array([0.1, 0.8, 0.03]),
    )  # fmt: skip


def draw(head: np.ndarray, rng: np.random.Generator) -> NDArray[np.uint8]:
    """A green picture (H, W, 3) with stands over it, in which all markings are drawn."""
    view = tripod().view(head, np.zeros((3, 3)))
    shift, factor = 3, 4
    picture = np.full((SIZE[1] * factor, SIZE[0] * factor, 3), (60, 120, 60), np.uint8)
    for marking in view.markings(template()).values():
        pixels = view.project(marking)
        pixels = pixels[np.isfinite(pixels).all(axis=1)]
        drawn = np.round(((pixels + 0.5) * factor - 0.5) * 2**shift).astype(np.int64)
        drawn = np.clip(drawn, -(2**20), 2**20).astype(np.int32)
        cv2.polylines(picture, [drawn.reshape(-1, 1, 2)], False, (230, 235, 230), 10, cv2.LINE_AA, shift)
    picture = cv2.resize(picture, SIZE, interpolation=cv2.INTER_AREA)
    noise = rng.normal(0.0, 3.0, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8)


def measure_ideal(
    head: np.ndarray,
    growth_m: np.ndarray,
    noise_px: float,
    rng: np.random.Generator,
    lever_m: float = 0.8,
    surface: Surface | None = None,
) -> MeasuredFrame:
    """What the paint of a frame shows of a pitch that is longer and broader than the template's, with noise across."""
    drawn, camera = template_curves(template()), tripod()
    common = camera.mean.copy()
    if surface is not None:
        camera, common[PLACE["crown"]] = replace(camera, surface=surface), surface.crown_m
    common[[PLACE["length"], PLACE["breadth"]]] = growth_m
    common[PLACE["lever"]] = lever_m
    theta = camera.model.thetas(head[None], common)[0]
    places = place_markings(drawn, theta, camera.model.projection, template().marking_width_m, 2.0 * SPACING_PX)
    off = rng.normal(0.0, noise_px, len(places.marking))
    count = np.bincount(places.marking, minlength=len(drawn.names))
    return MeasuredFrame(
        places.marking, places.field_m, places.pixels + off[:, None] * places.normals, places.normals,
        places.width_px, places.scale_px_m, np.zeros(len(off)), count, count,
    )  # fmt: skip


def views_of_a_surface(surface: Surface) -> list[HeadedFrame]:
    """Circle and both penalty areas of a usual pitch with that surface, with the noise of a good picture."""
    rng = np.random.default_rng(6)
    pans = (0.02, -0.01, -0.16, -0.42, -0.44, 0.16, 0.42, 0.44)
    heads = [np.array([np.log(2600.0 + 60.0 * k), pan, 1.38]) for k, pan in enumerate(pans)]
    views = [measure_ideal(head, np.zeros(2), 0.1, rng, surface=surface) for head in heads]
    return [HeadedFrame(str(k), head, seen) for k, (head, seen) in enumerate(zip(heads, views, strict=True))]


def views_of_a_pitch(length_m: float, width_m: float) -> list[HeadedFrame]:
    """Circle and penalty area of a pitch of any size, with the noise of a good picture and nothing that joins them."""
    growth = np.array([length_m - template().length_m, width_m - template().width_m])
    rng = np.random.default_rng(5)
    pans = (0.0, -0.02, -0.42, -0.44)
    heads = [np.array([np.log(2600.0 + 60.0 * k), pan, 1.38]) for k, pan in enumerate(pans)]
    return [HeadedFrame(str(k), head, measure_ideal(head, growth, 0.1, rng)) for k, head in enumerate(heads)]


def views_of_badly_painted_markings(
    seed: int, scatter_px: float, growth_m: tuple[float, float] = (0.0, 0.0)
) -> list[HeadedFrame]:
    """From one penalty area over the circle to the other, each marking beside its place by the same in all frames, of a
    pitch that is longer and broader than the template's.
    """
    rng = np.random.default_rng(5)
    heads = [np.array([np.log(2000.0 + 30.0 * k), pan, 1.38]) for k, pan in enumerate(np.linspace(0.1, -0.5, 8))]
    seen = [measure_ideal(head, np.array(growth_m), 0.1, rng) for head in heads]
    off = np.random.default_rng(seed).normal(0.0, scatter_px, len(template_curves(template()).names))
    moved = [replace(m, points_px=m.points_px + off[m.marking, None] * m.normals) for m in seen]
    return [HeadedFrame(str(k), head, m) for k, (head, m) in enumerate(zip(heads, moved, strict=True))]
