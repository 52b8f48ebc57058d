"""A clip from its pictures to the camera of every frame: one frame after the other, then smoothed shot by shot."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from circlecal.config import Config
from circlecal.pictures.interlacing import join_fields
from circlecal.pipeline import field_of
from circlecal.rig.tripod import Venue
from circlecal.tracking.answers import SigmaLimits, answer_shot
from circlecal.tracking.clock import StageClock
from circlecal.tracking.entry import ClipFrame, Entry
from circlecal.tracking.first_look import suit_tracking
from circlecal.tracking.follower import Follower
from circlecal.tracking.results import TrackedFrame
from circlecal.tracking.twins import answer_once

WINDOW, OVERLAP = 400, 150
"""Frames that are smoothed at once at most, and those that the next window shares with it."""


def track_frames(
    frames: Iterable[ClipFrame], venue: Venue, config: Config, clock: StageClock | None = None
) -> Iterator[TrackedFrame]:
    """The camera of every frame, in order; a frame comes out when the frames up to a few seconds later are in.

    Parameters
    ----------
    frames : iterable of ClipFrame
        The whole clip, in order.
    venue : Venue
        The cameras that may have taken it.
    config : Config
        Options.
    clock : StageClock, optional
        Told how long the stages take.

    Yields
    ------
    TrackedFrame
        One for each frame; memory does not grow with the length of the clip.
    """
    clock = clock or StageClock()
    yield from answer_once(frames, lambda distinct: _track_distinct(distinct, venue, config, clock))


def _track_distinct(
    frames: Iterator[ClipFrame], venue: Venue, config: Config, clock: StageClock
) -> Iterator[TrackedFrame]:
    """The camera of every frame of a clip that shows each of its pictures once."""
    template, _ = field_of(config)
    config = suit_tracking(config, venue.paint_bgr)
    limits = SigmaLimits.of(config.verdict)
    waiting: list[Entry] = []
    follower = Follower(venue, config, template, clock)

    def answer(count: int) -> list[TrackedFrame]:
        with clock.measure("smoothing"):
            return list(answer_shot(waiting, count, limits, has_cameras=bool(venue.tripods)))

    for frame in frames:
        if config.mask.deinterlace:
            with clock.measure("picture"):
                frame = replace(frame, picture=join_fields(frame.picture))
        entry = follower.follow(frame)
        if waiting and entry.shot != waiting[-1].shot:
            yield from answer(len(waiting))
            waiting = []
        waiting.append(entry)
        if len(waiting) >= WINDOW:
            yield from answer(WINDOW - OVERLAP)
            waiting = waiting[WINDOW - OVERLAP :]
    yield from answer(len(waiting))
