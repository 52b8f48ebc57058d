"""The answers of a shot: all its frames are smoothed together, and each is answered or refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from circlecal.field.view import FieldView
from circlecal.geometry.camera import Camera
from circlecal.geometry.camera_parameters import INDEX, ProjectionModel, project
from circlecal.geometry.projective import Array
from circlecal.refusals import REFUSALS
from circlecal.results import Check
from circlecal.rig.tripod import COMMON, TripodEstimate
from circlecal.stages.verdict import VerdictConfig
from circlecal.tracking.entry import BARE_SHARE, Entry
from circlecal.tracking.looking import Place
from circlecal.tracking.records import theta_of_view
from circlecal.tracking.results import Head, TrackedFrame
from circlecal.tracking.smoother import Chain, smooth_robustly

DRIFT_SD = (2e-5, 5e-6, 5e-6)
"""What the motion between neighbours leaves open beside its own standard deviation: logarithm of the focal length and
radians.
"""
FOLLOWED_FRAMES = 50
"""So long a camera is followed by motion alone, frames."""
DOUBTFUL_PLACES, DOUBTFUL_FRAMES = 40, 15
"""A picture that should show so many places of paint, and is not confirmed by them, is answered only where confirmed
frames lie as near as this on both sides: in a blurred moment of a fast pan.
"""
FAR = 10**6
"""Frames to a confirmed one where there is none."""
GRID_M = 2.5
"""Step of the grid over the pitch on which standard deviations are taken, metres: with 5 m their mean jumps by 0.35 px
in a picture that hardly moves, as a place comes into view at its border, with 2.5 m by 0.12 px, and with 1 m by 0.04.
"""
CLEARLY_LESS = 0.9
"""Share of the mean variance in the picture below which places are said to count from one end of the pitch: rounding
alone makes no difference where the length is known.
"""
MEAN_SIGMA_PX, MEAN_SHARE = 8.0, 1 / 3
"""Mean standard deviation of an answer over what is seen of the pitch, pixels at 1920 px width, that is the usual
limit, and its share of that of a frame alone, which counts where that was raised so far that it is more. A camera that
stands still before circle and a touchline leaves the width of its pitch open. Of 17 such clips two have 7 and 8 px on
average and 38 and 47 in a corner of the picture, and mean errors of 3 px; with 9 to 10 on average the mean errors of
three others are 2.5 to 7 px. Before a pitch of 110 by 89 m these are 9 and 42 px, and the mean error is 9 px.
"""


@dataclass(frozen=True, slots=True)
class SigmaLimits:
    """Largest standard deviations of an answer, anywhere on what is seen of the pitch and on average over it, pixels at
    1920 px width.
    """

    largest_px: float
    mean_px: float
    alone_px: float
    """The mean one of answers by a tripod that one frame tells: they are as good as that of a frame alone."""

    def mean_of(self, tripod: TripodEstimate) -> float:
        """The mean one by a tripod."""
        return self.alone_px if len(tripod.used) == 1 else self.mean_px

    @classmethod
    def of(cls, config: VerdictConfig) -> SigmaLimits:
        """Those that follow from the limits of frames alone: the largest one as it is, the mean one where it is lower
        than the usual one.
        """
        mean_px = config.max_mean_sigma_px
        return cls(config.max_sigma_px, min(mean_px, max(MEAN_SIGMA_PX, MEAN_SHARE * mean_px)), mean_px)


def answer_shot(
    entries: list[Entry], count: int, limits: SigmaLimits, *, has_cameras: bool = True
) -> Iterator[TrackedFrame]:
    """The first frames of one shot, after all of them were smoothed together.

    A frame in which no camera was found is refused as ``lost``, or as ``no_tripod`` where there was none to be found.
    """
    if not entries:
        return
    tracked = [k for k, entry in enumerate(entries) if entry.place is not None]
    smoothed: dict[int, tuple[Array, Array, Array]] = {}
    for run in _runs(entries, tracked):
        part = [entries[k] for k in run]
        found = smooth_robustly(_chain_of(part), np.array([_pull_of(entry) for entry in part]), _spread_of(part))
        smoothed |= dict(zip(run, zip(found.heads, found.covariances, found.by_common, strict=True), strict=True))
    support = _count_to_confirmation(entries)
    unfound = "lost" if has_cameras else "no_tripod"
    for k, entry in enumerate(entries[:count]):
        yield _refusal(entry, unfound) if k not in smoothed else _answer_frame(entry, *smoothed[k], support[k], limits)


def _pull_of(entry: Entry) -> Array:
    """How the paint of a tracked frame pulls its head along with common parameters and painters' errors (3, K + E)."""
    errors = 0 if entry.place is None else entry.place.by_errors.shape[1]
    pulls = (entry.pull, len(COMMON)), (entry.pull_by_errors, errors)
    return np.concatenate([np.zeros((3, count)) if pull is None else pull for pull, count in pulls], axis=1)


def _runs(entries: list[Entry], tracked: list[int]) -> list[list[int]]:
    """Runs of frames of one camera that follow each other."""
    runs: list[list[int]] = []
    for k in tracked:
        if runs and runs[-1][-1] == k - 1 and entries[k].motion is not None:
            runs[-1].append(k)
        else:
            runs.append([k])
    return runs


def _chain_of(entries: list[Entry]) -> Chain:
    """What the frames of a run show, and how the head moved from each to the next."""
    changes, precision = np.zeros((len(entries) - 1, 3)), np.zeros((len(entries) - 1, 3, 3))
    for j, entry in enumerate(entries[1:]):
        if entry.motion is not None:
            changes[j] = entry.motion.change
            precision[j] = np.linalg.inv(entry.motion.covariance + np.diag(np.square(DRIFT_SD)))
    heads, information, toward = zip(*((e.head, e.information, e.toward) for e in entries), strict=True)
    return Chain(np.array(heads), np.array(information), np.array(toward), changes, precision)


def _count_to_confirmation(entries: list[Entry]) -> list[int]:
    """How far each frame is from those that their paint confirms, along the motion.

    A frame that only follows confirmed ones may already belong to another shot, so the further side of the two counts;
    on one of them a frame whose paint is in place is enough, which no other shot has: before a cut or the end of a clip
    a pan may show nothing but a touchline.
    """
    is_confirmed = [entry.is_confirmed for entry in entries]
    is_in_place = [entry.is_in_place or entry.is_confirmed for entry in entries]
    sides = (is_confirmed, is_in_place), (is_in_place, is_confirmed)
    ways = [(_count_from_before(entries, before), _count_from_after(entries, after)) for before, after in sides]
    return np.min([np.max(way, axis=0) for way in ways], axis=0).tolist()


def _count_from_before(entries: list[Entry], is_one: list[bool]) -> list[int]:
    """Frames since the last one of some kind, along the motion."""
    counts, near = [], FAR
    for entry, is_here in zip(entries, is_one, strict=True):
        near = 0 if is_here else near + 1 if entry.motion is not None else FAR
        counts.append(near)
    return counts


def _count_from_after(entries: list[Entry], is_one: list[bool]) -> list[int]:
    """Frames until the next one of some kind, along the motion."""
    counts, near = [], FAR
    for entry, is_here in zip(reversed(entries), reversed(is_one), strict=True):
        near = 0 if is_here else near + 1
        counts.append(near)
        if entry.motion is None:
            near = FAR
    return counts[::-1]


def _refusal(entry: Entry, code: str) -> TrackedFrame:
    return TrackedFrame(entry.index, entry.time_s, entry.size, entry.shot, None, "refused", code, REFUSALS[code].words)


def _answer_frame(
    entry: Entry, values: Array, covariance: Array, by_common: Array, support: int, limits: SigmaLimits
) -> TrackedFrame:
    """The answer of a frame that was followed, or why it is refused."""
    place = entry.place
    if place is None:
        return _refusal(entry, "lost")
    tripod = place.tripod
    by_head = by_common[:, : len(COMMON)]
    view, follows = tripod.view(values, covariance, by_head), None
    seen = _visible_sigmas(view, place)
    sigmas = (
        Check.of("sigma_px", seen.largest_px, limits.largest_px * place.unit),
        Check.of("mean_sigma_px", seen.mean_px, limits.mean_of(tripod) * place.unit),
    )
    checks = (
        Check("painted_share", entry.painted / max(entry.expected, 1), BARE_SHARE, not entry.is_contradicted),
        Check("missing_markings", float(entry.missing), 0.0, entry.missing == 0),
        Check("frames_to_confirmed", float(support), FOLLOWED_FRAMES, support <= FOLLOWED_FRAMES),
        *sigmas,
    )
    if place.by_errors.shape[1]:
        # painters' errors are told, and refuse nothing: no picture tells them, and the limits are those of noise
        follows = np.concatenate([by_common[:, len(COMMON) :], place.by_errors])
        view = tripod.view(values, covariance, by_head, follows)
        seen = _visible_sigmas(view, place)
    head = Head(float(values[1]), float(values[2]), float(values[0]), tripod.widen_head(covariance, by_head, follows))
    frame = TrackedFrame(
        entry.index, entry.time_s, entry.size, entry.shot, tripod.name, "calibrated", None, None, view, head,
        entry.carriers, checks, seen.largest_px, seen.largest_m, seen.end,
    )  # fmt: skip
    if entry.missing > 0 or support > (DOUBTFUL_FRAMES if entry.expected >= DOUBTFUL_PLACES else FOLLOWED_FRAMES):
        return _refuse(frame, "paint_missing")
    return frame if all(check.passed for check in sigmas) else _refuse(frame, "too_uncertain")


def _refuse(frame: TrackedFrame, code: str) -> TrackedFrame:
    return replace(frame, status="refused", code=code, reason=REFUSALS[code].words)


def _spread_of(entries: list[Entry]) -> float:
    """Variance of the paint in frames about its markings, as a share of what it is taken to have: of rendered clips
    0.05 to 0.2. That of one frame more is as it is taken to be, so that few frames tell little.
    """
    off, expected = np.sum([entry.spread for entry in entries], axis=0)
    as_taken = expected / len(entries)
    return float((off + as_taken) / (expected + as_taken)) if expected > 0.0 else 1.0


@dataclass(frozen=True, slots=True)
class _SeenSigmas:
    """Largest and mean standard deviation over what is seen of the pitch, pixels, the largest on the ground, metres,
    and the end of the pitch from which places of the frame are told best (-1 or 1 by the sign of its x), 0 for the
    middle.
    """

    largest_px: float
    mean_px: float
    largest_m: float
    end: int


def _visible_sigmas(view: FieldView, place: Place) -> _SeenSigmas:
    """Standard deviations over places of the pitch that the picture shows. Each place is counted from the middle of the
    pitch or from its nearer end, whichever it is told by better: where only one end is seen, how long the pitch is says
    nothing of where that end is in the picture.
    """
    points = view.visible_field(place.template, step_m=GRID_M)
    if len(points) == 0 or view.covariance is None or not isinstance(view.camera, Camera):
        return _SeenSigmas(float("inf"), float("inf"), float("inf"), 0)
    seen = project(theta_of_view(view)[None], points[None], ProjectionModel.of(view.camera, view.surface))
    by_theta, by_field = (derivatives[0] for derivatives in seen.jacobians())
    ends = np.array([0.0, -1.0, 1.0])
    counted = np.repeat(by_theta[None], len(ends), axis=0)
    counted[1:, :, :, INDEX["length"]] = by_field[:, :, 0] * ends[1:, None, None] / 2.0
    variance_px, variance_m = (
        ((rows @ view.covariance) * rows).sum(axis=(2, 3)) for rows in (counted, np.linalg.solve(by_field, counted))
    )
    nearer = np.where(points[:, 0] < 0.0, 1, 2), np.arange(len(points))
    least_px, least_m = (np.minimum(v[0], v[nearer]) for v in (variance_px, variance_m))
    sigma = np.sqrt(np.maximum(least_px, 0.0))
    means = np.nanmean(variance_px, axis=1)
    best = int(np.argmin(means))
    end = int(ends[best]) if means[best] < CLEARLY_LESS * means[0] else 0
    return _SeenSigmas(float(np.nanmax(sigma)), float(np.nanmean(sigma)), float(np.sqrt(np.nanmax(least_m))), end)
