"""A clip, and tracking whose answers are known: what comes out of a run is tested with it, not what tracking finds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from circlecal.config import Config
from circlecal.geometry.surface import Surface
from circlecal.pictures.video_writer import write_video
from circlecal.results import Check
from circlecal.rig.tripod import COMMON, PLACE, TripodEstimate, Venue
from circlecal.tracking.entry import ClipFrame
from circlecal.tracking.results import Head, TrackedFrame
from circlecal.tracking.survey_steps import UNTOLD, SurveySteps

SIZE, RATE = (320, 180), 10.0
CUT_FRAME, LOST_FRAMES = 20, (7, 8)


def write_clip(path: Path, frames: int = 30) -> Path:
    with write_video(path, RATE) as writer:
        for k in range(frames):
            writer.write(np.full((SIZE[1], SIZE[0], 3), 40 + 3 * (k % 40), np.uint8), k / RATE)
    return path


def tripod(size: tuple[int, int] = SIZE) -> TripodEstimate:
    rng = np.random.default_rng(3)
    root = 1e-2 * rng.normal(size=(len(COMMON), len(COMMON)))
    covariance = root @ root.T
    for name in ("kappa_2", "log_aspect"):
        covariance[PLACE[name]] = covariance[:, PLACE[name]] = 0.0
    mean = np.zeros(len(COMMON))
    mean[:3], mean[PLACE["lever"]], mean[PLACE["kappa_1"]], mean[PLACE["crown"]] = (1.0, 62.0, -15.0), 0.6, 0.02, 0.05
    mean[PLACE["length"]], mean[PLACE["breadth"]] = -1.5, 0.7
    low, high = np.array([np.log(1.2 * size[0]), -0.6, 1.2]), np.array([np.log(3.0 * size[0]), 0.6, 1.45])
    surface = Surface("roof", 9.15, 0.05)
    return TripodEstimate("camera-1", size, float(np.log(1.5 * size[0])), surface, mean, covariance, low, high, ("a",))


def tracked(index: int, time_s: float, size: tuple[int, int] = SIZE) -> TrackedFrame:
    """A frame of a slow pan: refused twice, and behind a cut from :data:`CUT_FRAME` on."""
    shot = int(index >= CUT_FRAME) + 5
    if index in LOST_FRAMES:
        return TrackedFrame(index, time_s, size, shot, None, "refused", "lost")
    camera = tripod(size)
    own = np.array([camera.log_focal, 0.002 * index, 1.33])
    spread = np.diag([1e-4, 1e-5, 1e-5]) ** 2
    return TrackedFrame(
        index,
        time_s,
        size,
        shot,
        camera.name,
        "calibrated",
        view=camera.view(own, spread),
        head=Head(own[1], own[2], own[0], spread),
        carriers=("circle", "lines"),
        checks=(Check("paint", 0.9, 0.5, True),),
        sigma_px=0.3,
        sigma_m=0.02,
    )


def survey_clip(
    pictures_at: object,
    duration_s: float,
    config: Config,
    known: Venue | None = None,
    anchors: object = (),
    period_s: float = 0.0,
    steps: SurveySteps = UNTOLD,
) -> Venue:
    for _ in steps.count("looking at frames", range(2), 2):
        pass
    return known or Venue(config.field.template, (replace(tripod(), used=("a", "b")),))


def track_frames(frames: Iterable[ClipFrame], venue: Venue, config: Config) -> Iterator[TrackedFrame]:
    for frame in frames:
        height, width = frame.picture.shape[:2]
        yield tracked(frame.index, frame.time_s, (width, height))
