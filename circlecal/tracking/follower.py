"""Goes through a clip frame by frame: follows the camera, loses it, searches for it, and goes back from where it is."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from circlecal.config import Config
from circlecal.field import FieldTemplate
from circlecal.geometry.projective import Array
from circlecal.rig.tripod import Venue
from circlecal.tracking.answers import FOLLOWED_FRAMES
from circlecal.tracking.clock import StageClock
from circlecal.tracking.coarse_motion import estimate_coarsely
from circlecal.tracking.entry import EXPECTED_PLACES, ClipFrame, Entry
from circlecal.tracking.looking import LEAST_PLACES, Look, LookedAt, Place
from circlecal.tracking.motion import SHUTTER, CornerTrail, Flow, HeadMotion, estimate_motion, move_of_middle

HEAD_SD = (1e-3, 2e-4, 2e-4)
"""By how much a head that follows the motion may be off, for each frame that was not confirmed: logarithm of the focal
length and radians.
"""
SEARCHES = (0, 2, 5, 9, 14, 20)
"""Frames after a cut in which the camera is searched for; later in every :data:`SEARCH_EVERY`-th. Those before it is
found are followed backwards.
"""
SEARCH_EVERY = 12
BACKWARD_FRAMES, BACKWARD_BYTES = 48, 120_000_000
"""Frames without a confirmed camera whose pictures are kept at most, to be followed backwards from one that is found,
and what their gray levels may take of the memory.
"""
MANY_CORNERS = 30
"""Corners that tell a motion well enough; where fewer do, the picture is smeared, and is followed coarsely. In a
rendered pan 30 to 150 agree below 150 px a frame at 1920 px width, and none to 20 beyond.
"""
GUESS_SD_PX, GUESS_SD_ZOOM, GUESS_SHARE = 5.0, 0.004, 0.05
"""Of a head that goes on turning and speeding up as it did, where no motion could be measured: pixels at 1920 px width,
logarithm of the focal length, and share of the change of pan and of tilt. The paint must confirm it. In a rendered pan
that reaches 150 px a frame it is off by 1 to 8 px; going on as fast as before, without speeding up, by 13 to 20.
"""
LEAST_WORTH = 15.0
"""Places of paint, times the share that is seen and the share that is explained, for which a guess is followed where no
motion could be measured: right ones have 40 to 200, wrong ones 3 to 15.
"""
SURPRISE = 3.0
"""Standard deviations of the guess beyond which a motion is compared with it by the paint that either shows."""
STANDING_PX, GOING_PX = 0.3, 2.0
"""Motion up to which a picture stands still, and from which on a head does not stop at once, pixels at 1920 px width:
of a strip of graphics over a real pan the corners move by 0.0.
"""
GUESS_SHARE_OF_WORTH = 0.8
"""A guess whose paint is worth so much of that along a motion that surprises is taken, being the less certain of the
two. Where the motion does not surprise, the paint along it must be worth as little of that of the guess: in a rendered
pan of 110 px a frame the two were worth 141 and more than 113, and the guess 2 px off.
"""
SECOND_LOOK = 16.0
"""How much surer a head is after the paint was found once, as a share of its covariance."""
WIDE_PX = 1.0
"""Standard deviation of the place of a head, pixels at 1920 px width, from which on the paint is looked at again where
it was found: in a fast pan that only paint tells, profiles reach over the run-off beyond a far touchline, whose middle
then is off by half a pixel.
"""
GRASS_FRAMES, GRASS_WAY_PX = 10, 80.0
"""The playing surface is looked for again after so many frames while the camera is followed, and where the picture has
moved so far since, pixels at 1920 px width.
"""
PATIENCE = 12
"""Frames in a row that contradict the camera before it is searched for again."""


@dataclass(frozen=True, slots=True)
class KnownHead:
    """A head (3,) that is known, and the way (2,) of the picture while the shutter was open where that is."""

    head: Array
    blur_px: Array | None = None


@dataclass(frozen=True, slots=True)
class _Kept:
    """A frame that may be followed backwards: its picture, and how the corners of the frame before moved into it."""

    entry: Entry
    picture: LookedAt
    flow: Flow | None


@dataclass(frozen=True, slots=True)
class _Followed:
    """A look along a motion, with the head (3,) and covariance (3, 3) that it began with, and the way (2,) that it
    expected the picture to move while the shutter was open, pixels.
    """

    motion: HeadMotion
    look: Look
    head: Array
    covariance: Array
    blur_px: Array

    @property
    def reach_px(self) -> float:
        """How far from the markings the paint was looked for because of where the head may turn, pixels."""
        return float(np.sqrt(np.diag(self.covariance)[1:].max()) * np.exp(self.head[0]))

    @property
    def should_show_more(self) -> bool:
        """Whether the picture should show paint, and does not confirm the head."""
        return not self.look.is_confirmed and int(self.look.measured.expected.sum()) >= EXPECTED_PLACES

    def look_again(self, place: Place, picture: LookedAt, by_common: Array | None) -> _Followed:
        """Where the first look found the paint: what lies beside it is not taken for it any more."""
        if len(self.look.measured.marking) < LEAST_PLACES // 2:
            return self
        covariance, head = self.covariance / SECOND_LOOK, self.look.fit.head
        look = place.look(picture, head, covariance, by_common, self.blur_px)
        return replace(self, look=look, head=head, covariance=covariance)


@dataclass(frozen=True, slots=True)
class _Inertia:
    """How a head turned into the last frame, by which it may be expected to go on.

    Attributes
    ----------
    change, acceleration : (3,) arrays
        Of the head into the last frame, and by how much that was more than the change before.
    velocity_px : (2,) array
        How far the middle of the picture moved with it, pixels.
    is_moving : bool
        Whether the camera was followed into the last frame, so that these are known.
    """

    change: Array = field(default_factory=lambda: np.zeros(3))
    acceleration: Array = field(default_factory=lambda: np.zeros(3))
    velocity_px: Array = field(default_factory=lambda: np.zeros(2))
    is_moving: bool = False

    def go_on(self, place: Place, before: Entry, change: Array) -> _Inertia:
        """After the head of the frame before has changed (3,)."""
        acceleration = change - self.change if self.is_moving else np.zeros(3)
        return _Inertia(change, acceleration, _move_px(place, before, change), True)

    def guess(self, place: Place, before: Entry) -> HeadMotion:
        """That the head of the frame before goes on turning, and speeding up or slowing down, as it did."""
        change = self.change + self.acceleration
        turn = GUESS_SD_PX * place.unit / float(np.exp(before.head[0])) + GUESS_SHARE * np.abs(change[1:])
        return HeadMotion(change, np.diag(np.square([GUESS_SD_ZOOM, *turn])), 0.0, 0)

    def is_surprised(self, place: Place, before: Entry, motion: HeadMotion, guess: HeadMotion) -> bool:
        """Whether a motion is far from the guess, or none where there was one: the head has inertia, players have
        little, and graphics stand still.
        """
        away = np.abs(motion.change - guess.change)[1:]
        if (away > SURPRISE * np.sqrt(np.diag(guess.covariance))[1:]).any():
            return True
        still, moving = STANDING_PX * place.unit, GOING_PX * place.unit
        return bool(np.hypot(*_move_px(place, before, motion.change)) < still and np.hypot(*self.velocity_px) > moving)


def _blur_px(moved_px: Array, before: Entry, after: Entry) -> Array:
    """Way (2,) of the picture while the shutter was open, where it moved so far (2,) from one frame to another."""
    return np.asarray(SHUTTER / max(after.index - before.index, 1) * moved_px)


def _move_px(place: Place, before: Entry, change: Array) -> Array:
    """How far (2,) the middle of the picture moves where the head of the frame before changes (3,)."""
    return move_of_middle(change, before.head, place.tripod.model, place.tripod.mean)


class Follower:
    """Goes through a clip; knows the last frame.

    Parameters
    ----------
    venue : Venue
        The cameras.
    config, template, clock : Config, FieldTemplate, StageClock
        Options, the field, and what is told how long the stages take.
    heads : mapping, optional
        Heads of the first camera that are known, by the numbers of their frames: a camera that is lost is looked for
        there, and not searched for anywhere.
    """

    def __init__(
        self,
        venue: Venue,
        config: Config,
        template: FieldTemplate,
        clock: StageClock,
        heads: Mapping[int, KnownHead] | None = None,
    ) -> None:
        self._venue, self._config, self._template, self._clock, self._heads = venue, config, template, clock, heads
        self._places: dict[tuple[int, int], list[Place]] = {}
        self._trail = CornerTrail()
        self._rng = np.random.default_rng(config.seed)
        self._last: LookedAt | None = None
        self._entry: Entry | None = None
        self._shot = 0
        self._since_cut, self._unconfirmed, self._contradicted = 0, 0, 0
        self._inertia = _Inertia()
        self._since_surface, self._way_since_surface = 0, 0.0
        self._surface: Array | None = None
        """Colour of the playing surface where the paint last confirmed a camera."""
        self._behind: deque[_Kept] = deque()
        """Frames since the last one whose camera was confirmed, of one shot."""

    def follow(self, frame: ClipFrame) -> Entry:
        """The next frame."""
        before, last = self._entry, self._last
        is_followed = before is not None and before.is_confirmed and self._is_near_surface()
        with self._clock.measure("picture"):
            picture = self._take_picture(frame, last if is_followed else None)
        entry = Entry(frame.index, frame.time_s, picture.size, self._shot)
        flow = self._follow_corners(picture)
        look = None
        if before is not None and last is not None and flow is not None:
            look = self._continue(entry, before, last, picture, flow)
        if look is None or self._contradicted >= PATIENCE or self._unconfirmed > FOLLOWED_FRAMES:
            if is_followed:
                picture = self._take_picture(frame, None)
            picture = self._begin_anew(entry, picture, flow, is_torn=look is None)
        if entry.is_confirmed and not is_followed:
            self._surface = picture.colour
        self._keep(_Kept(entry, picture, flow))
        self._entry, self._last = entry, picture
        return entry

    def _take_picture(self, frame: ClipFrame, last: LookedAt | None) -> LookedAt:
        """The picture of a frame, with the playing surface of the last one, or looked for where there is none."""
        picture = LookedAt.of(frame.picture, self._config.mask, last)
        if last is not None:
            return picture
        self._since_surface, self._way_since_surface = 0, 0.0
        return picture.take_surface(self._surface)

    def _follow_corners(self, picture: LookedAt) -> Flow | None:
        """How the corners of the last picture moved into this one; None where that is of another size, or none."""
        if self._last is None or self._last.size != picture.size:
            self._trail.forget()
            return None
        with self._clock.measure("motion"):
            return self._trail.follow(self._last.small, picture.small, self._inertia.velocity_px)

    def _begin_anew(self, entry: Entry, picture: LookedAt, flow: Flow | None, is_torn: bool) -> LookedAt:
        """Lose the camera of the frame before, which corners, windows and paint may not carry on to this one, and find
        one where it is time to search. The picture is returned with the surface on which a camera was found.
        """
        before, last = self._entry, self._last
        was_followed = before is not None and before.place is not None
        # what nothing carries on from the picture before is another shot
        is_cut = last is not None and ((is_torn and was_followed) or picture.differs_from(last))
        self._lose(entry, was_followed, is_cut)
        if self._is_time_to_search(entry.index):
            with self._clock.measure("search"):
                picture = self._find(entry, picture)
            place = entry.place
            if before is not None and place is not None and place is before.place and not is_cut:
                self._go_on(place, before, entry.head - before.head)
        self._since_cut += 1
        if entry.place is not None:
            with self._clock.measure("backward"):
                self._go_back(_Kept(entry, picture, flow))
        return picture

    def _keep(self, kept: _Kept) -> None:
        """Keep a frame for the way back, unless its camera is confirmed."""
        if kept.entry.is_confirmed:
            self._behind.clear()
            return
        self._behind.append(kept)
        if len(self._behind) > min(BACKWARD_FRAMES, max(1, BACKWARD_BYTES // kept.picture.gray.size)):
            self._behind.popleft()

    def _go_back(self, found: _Kept) -> None:
        """Follow the camera backwards from a frame in which it was found, through the frames in which it was not."""
        later, unconfirmed = found, 0
        change: Array | None = None
        while self._behind:
            earlier = self._behind.pop()
            look = self._step_back(later, earlier, unconfirmed, change)
            if look is None:
                return
            unconfirmed = 0 if look.is_confirmed else unconfirmed + 1
            change = earlier.entry.head - later.entry.head
            if unconfirmed >= PATIENCE:
                return
            later = earlier

    def _step_back(self, later: _Kept, earlier: _Kept, unconfirmed: int, expected: Array | None) -> Look | None:
        """Follow the camera from a frame into the one before it, into which the head may be expected to change (3,);
        None where it cannot be followed.
        """
        entry, place, flow = later.entry, later.entry.place, later.flow
        if place is None or flow is None or later.picture.size != earlier.picture.size:
            return None
        back = Flow(flow.after, flow.before)
        motion = self._estimate_motion(place, back, later.picture, earlier.picture, entry.head, expected)
        if motion is None:
            return None
        head = entry.head + motion.change
        covariance = motion.covariance + np.diag(np.square(HEAD_SD)) * (1 + unconfirmed)
        blur = _blur_px(_move_px(place, entry, motion.change), earlier.entry, entry)
        look = place.look(earlier.picture, head, covariance, entry.by_common, blur)
        entry.motion = replace(motion, change=-motion.change)
        earlier.entry.place = place
        earlier.entry.take(look, head, covariance)
        if earlier.entry.by_common is None:
            earlier.entry.by_common = entry.by_common
        return look

    def _estimate_motion(
        self, place: Place, flow: Flow, first: LookedAt, second: LookedAt, head: Array, expected: Array | None
    ) -> HeadMotion | None:
        """How a head (3,) turns from one picture to another, by their corners, or coarsely where these are few, about a
        change (3,) that may be expected; None where nothing tells it.
        """
        tripod = place.tripod
        motion = estimate_motion(flow, head, tripod.model, tripod.mean, self._rng, first.small.factor)
        if motion is not None and motion.inliers >= MANY_CORNERS:
            return motion
        smeared = estimate_coarsely(first.coarse, second.coarse, expected, head, tripod.model, tripod.mean, self._rng)
        return motion if smeared is None else smeared

    def _continue(self, entry: Entry, before: Entry, last: LookedAt, picture: LookedAt, flow: Flow) -> Look | None:
        """Follow the camera of the frame before, which showed the last picture; None where it cannot be followed."""
        place = before.place
        if place is None:
            return None
        guess = self._inertia.guess(place, before)
        expected = guess.change if self._inertia.is_moving else None
        with self._clock.measure("motion"):
            motion = self._estimate_motion(place, flow, last, picture, before.head, expected)
        with self._clock.measure("paint"):
            followed = self._choose_motion(place, picture, before, entry, motion, guess)
            if followed is not None and followed.reach_px > WIDE_PX * place.unit:
                followed = followed.look_again(place, picture, before.by_common)
        if followed is None:
            return None
        look = followed.look
        entry.place, entry.motion = place, followed.motion
        entry.take(look, followed.head, followed.covariance)
        if entry.by_common is None:
            entry.by_common = before.by_common
        sure = look.is_confirmed and before.is_confirmed
        self._go_on(place, before, entry.head - before.head if sure else followed.motion.change)
        self._unconfirmed = 0 if look.is_confirmed else self._unconfirmed + 1
        self._contradicted = self._contradicted + 1 if entry.is_contradicted else 0
        return look

    def _choose_motion(
        self,
        place: Place,
        picture: LookedAt,
        before: Entry,
        entry: Entry,
        motion: HeadMotion | None,
        guess: HeadMotion,
    ) -> _Followed | None:
        """A look along the motion that was measured, or along the one that is guessed where the paint knows better:
        blur leaves no corners but those of players and graphics. None where neither is worth following.
        """
        measured = None if motion is None else self._look_along(place, picture, before, entry, motion)
        is_surprise = motion is None or self._inertia.is_surprised(place, before, motion, guess)
        if measured is not None and not is_surprise and not measured.should_show_more:
            return measured
        guessed = self._look_along(place, picture, before, entry, guess)
        guessed = guessed.look_again(place, picture, before.by_common)
        may_be_better = measured is None or (is_surprise and not measured.look.is_confirmed)
        if not guessed.look.is_confirmed and not may_be_better:
            return measured
        share = GUESS_SHARE_OF_WORTH if is_surprise else 1.0 / GUESS_SHARE_OF_WORTH
        least = LEAST_WORTH if measured is None else share * measured.look.worth
        return guessed if guessed.look.worth > least else measured

    def _look_along(
        self, place: Place, picture: LookedAt, before: Entry, entry: Entry, motion: HeadMotion
    ) -> _Followed:
        """Look where a motion takes the camera of the frame before."""
        head = before.head + motion.change
        covariance = motion.covariance + np.diag(np.square(HEAD_SD)) * (1 + self._unconfirmed)
        blur = _blur_px(_move_px(place, before, motion.change), before, entry)
        look = place.look(picture, head, covariance, before.by_common, blur)
        return _Followed(motion, look, head, covariance, blur)

    def _go_on(self, place: Place, before: Entry, change: Array) -> None:
        """Expect the head to change as it did since the frame before."""
        self._inertia = self._inertia.go_on(place, before, change)
        self._since_surface += 1
        self._way_since_surface += float(np.hypot(*self._inertia.velocity_px)) / place.unit

    def _is_near_surface(self) -> bool:
        """Whether the playing surface is where it was looked for last, as far as counts."""
        return self._since_surface < GRASS_FRAMES and self._way_since_surface < GRASS_WAY_PX

    def _lose(self, entry: Entry, was_followed: bool, is_cut: bool) -> None:
        """Begin a shot, or go on in one, whose camera is not known so far."""
        if was_followed or is_cut:
            self._shot += 1
            self._since_cut = 0
        if is_cut:
            self._behind.clear()
        elif was_followed:
            for kept in self._behind:
                kept.entry.forget(self._shot)
        entry.forget(self._shot)
        self._inertia = _Inertia()
        self._unconfirmed = self._contradicted = 0

    def _is_time_to_search(self, index: int) -> bool:
        if self._heads is not None:
            return index in self._heads
        since = self._since_cut
        return since in SEARCHES or (since > max(SEARCHES) and since % SEARCH_EVERY == 0)

    def _find(self, entry: Entry, picture: LookedAt) -> LookedAt:
        """Search for each of the cameras; the one with the most paint has the frame. The picture is returned with the
        surface on which a camera was found, while the colour of the playing surface is not known.
        """
        pictures = [picture]
        if self._surface is None:
            pictures.append(picture.take_other_surface())
        for seen in pictures:
            best: tuple[Place, Look] | None = None
            for place in self._places_of(seen.size) if seen.shows_surface else ():
                known = None if self._heads is None else self._heads[entry.index]
                look = place.find(seen) if known is None else place.confirm(seen, known.head, known.blur_px)
                if look is not None and (best is None or look.measured.painted.sum() > best[1].measured.painted.sum()):
                    best = place, look
            if best is not None:
                entry.place, look = best
                entry.take(look, look.fit.head)
                return seen
        return picture

    def _places_of(self, size: tuple[int, int]) -> list[Place]:
        if size not in self._places:
            tripods = (t if t.size == size else t.resize(size) for t in self._venue.tripods)
            self._places[size] = [Place.of(tripod, self._template) for tripod in tripods]
        return self._places[size]
