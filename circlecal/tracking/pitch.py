"""The pitch before a tripod: the shape of its surface, and its length and width, by the frames that tell them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from circlecal.camera.spike_and_slab import UNLIKELY_SHARE
from circlecal.camera.world import Size, are_usual
from circlecal.field import FieldTemplate
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import SurfaceShape
from circlecal.rig.tripod import COMMON, PLACE, TripodEstimate
from circlecal.tracking.frame_paint import HeadedFrame
from circlecal.tracking.looking import LookedAt, Place
from circlecal.tracking.markings import CLEAR_PX_M, DrawnTemplate
from circlecal.tracking.touchlines import find_width
from circlecal.tracking.tripod_fit import TripodFit, count_alike, excess_of, fit_tripod

SHAPES: tuple[SurfaceShape, ...] = ("roof", "parabola")
"""Surfaces that are tried, the usual one first. With hipped roofs beside them a pitch 66.4 m wide was held at 68 m."""
WORST_RMS_PX = 2.0
"""A frame whose paint lies further from its tripod's markings, root mean square, pixels at 1920 px width, was
calibrated wrongly: rendered frames have 0.05 to 0.4, real ones up to 1.3, since real pitches fall in more ways than the
models of the surface.
"""
DECISIVE, DECISIVE_SHARE = 10.0, 0.05
"""Difference in cost by which another surface must be better than a roof, and its share of the cost where the size of
the pitch is free: on real clips the better of roof and parabola has 9 to 48 % less where penalty areas are in view;
with the circle alone in view 3 % chose the wrong one, and with it a pitch that is 4 m too broad.
"""
SIZE = [PLACE["length"], PLACE["breadth"]]
TOLD_SD_M, USUAL_SD_M, FAR_SIGMAS = 0.5, 1.0, 3.0
"""Standard deviation of a size up to which frames tell it, and of the usual size where they do not, metres: penalty
areas alone fit a pitch of any length, and one of 107.5 by 88 m was taken for the template's, 63 px off. What lies so
many of the latter away is another size: one of 118.9 m, told to 0.503 m, was drawn towards 105 m by 0.6 m.
"""
OPEN_SD_M, OUTER_FRAMES = 0.3, 3
"""Standard deviation of a length from which on others are tried, metres, and frames to each side by which: where a clip
ends as a penalty area comes into view, its lines are too uncertain to be looked for, and it tells nothing.
"""
LENGTH_STEP_M, LENGTH_SD_M, LEAST_MORE_WORTH = 0.5, 0.25, 40.0
"""Of the lengths that are tried, what is left open of the one that is found, metres, and places of paint by which it
must show more than half of all lengths do: 90 and 270 on two clips of one ground; without a penalty area in view 15.
"""
WIDTH_SD_M = 0.3
"""What is left open of a width that is searched for, metres: in 14 rendered clips it is 0.0 to 0.2 off where the rest
of the tripod is known.
"""


@dataclass(frozen=True, slots=True)
class UsualSize:
    """A hypothesis of the size of a pitch.

    Attributes
    ----------
    is_usual : (bool, bool)
        Whether the length, and whether the width, is the template's.
    most_cost, rough_cost : float
        By how much more it may cost than a pitch of any size; and by how much where the models leave more than noise,
        beside how far markings are off alike.
    """

    is_usual: tuple[bool, bool]
    most_cost: float
    rough_cost: float


USUAL_SIZES = (
    UsualSize((True, True), 11.0, 15.0),
    UsualSize((False, True), 1.0, 1.0),
)
"""Sizes in the order in which they are tried. What each may cost is what the prior has for it, twice the logarithm,
less that of hundred to one. Of professional pitches five in six have the template's size; of the others every second is
as wide and every third as long; and frames tell each to 0.3 m of the 30 and 45 m that the Laws allow. A length of
104.4 m beside a width of 61.3 m costs 8 at 105 m, and was held there, 22 px off before a penalty area; so a length
alone is not held.

Where the models leave more than noise, as on all real clips, all frames repeat it, over whole markings, and the cost
counts by how far markings are off alike: divided by 8 to 180. So divided, six real pitches cost 0.4 to 4.6 at the
template's size, ideal ones with painters' errors 1.4 to 9.5, one seen from behind its goal 12, and others, whose paint
lies beside it, 21 (103.5 m long), 21 (66.4 m wide) and some hundred (100 and 101.5 m); at the template's width those of
them that are 68 m wide 0.0 to 0.2. The one from behind its goal comes out as 104.2 by 68.3 m, and the template's size
explains its paint as well (74 of 74 frames either way). One of 106.6 by 67.2 m costs 3, and is told by a frame that the
template's size does not explain.
"""
EXCESS_LEFT = 0.65
"""Share of the mean square distance beyond noise that may be left without a far line round the field which is a false
one: with the foot of the boards taken for a touchline, beside what painters leave, 0.01 to 0.56, without the far
touchlines of twelve real pitches 0.78 to 1.34. Of lines that are near, and where no more is left than noise makes,
nothing may be left.
"""
JOINT_PLACES, JOINT_FRAMES = (30, 15), 3
"""Places of paint on a circle in the middle of the field and on markings at an end, by which one picture shows both,
and number of such pictures that tell how far the ends are apart.
"""


def choose_pitch(
    frames: list[HeadedFrame],
    tripod: TripodEstimate,
    mean: Array,
    sd: Array,
    drawn: DrawnTemplate,
    limit_px: float,
    *,
    is_hipped: bool = False,
) -> TripodFit:
    """The fit with the better shape of the surface; with a pitch of the template's size, or at least of its width,
    where that explains the paint about as well.

    Parameters
    ----------
    frames : list of HeadedFrame
        What they show.
    tripod : TripodEstimate
        Where the fit starts.
    mean, sd : (K,) array
        Prior of what all frames share.
    drawn : DrawnTemplate
        Markings of the field.
    limit_px : float
        A frame whose paint lies further from its markings, root mean square, counts as falsely calibrated.
    is_hipped : bool
        Whether the surface is known to be a hipped roof, which the better of roof and parabola then gives way to.
    """
    frames, shaped = leave_out_false_line(frames, _of_shapes(tripod, SHAPES), mean, sd, drawn)
    alike = min(map(count_alike, shaped))
    if alike > 1.0:
        shaped = [fit_tripod(frames, f.estimate, mean, sd, drawn, alike=alike) for f in shaped]
    chosen, mean, sd = _choose_size(frames, shaped, alike, (mean, sd), drawn, limit_px)
    if not is_hipped:
        return chosen
    (hipped,) = _of_shapes(chosen.estimate, ["hip"])
    return fit_tripod(frames, hipped, mean, sd, drawn, alike=alike)


def may_be_hip(frames: list[HeadedFrame], tripod: TripodEstimate, mean: Array, sd: Array, drawn: DrawnTemplate) -> bool:
    """Whether a hipped roof explains the paint clearly better than the surface that a tripod was found before.

    Parameters are those of :func:`choose_pitch`. Of eleven real pitches four seem so, and one of these costs 3.5 times
    as much before a roof, which has a fifth of the crown that its circle shows, a tripod that leans by 0.7 degrees, a
    principal point 40 px off, and the circle 1.6 px off its paint. Four are roofs up to their goal lines.
    """
    mean, sd = hold_size(tripod, mean, sd)
    found, hipped = (fit_tripod(frames, t, mean, sd, drawn) for t in (tripod, *_of_shapes(tripod, ["hip"])))
    return choose_surface(found, hipped, DECISIVE_SHARE) is hipped


def _choose_size(
    frames: list[HeadedFrame],
    shaped: Sequence[TripodFit],
    alike: float,
    prior: tuple[Array, Array],
    drawn: DrawnTemplate,
    limit_px: float,
) -> tuple[TripodFit, Array, Array]:
    """The fit before a pitch of the usual size, or width, or of any, and the prior of what all frames share before it.

    ``shaped`` are the fits before a roof and a parabola of any size; all else is as for :func:`choose_pitch`.
    """
    mean, sd = prior
    roof, parabola = shaped
    free = choose_surface(roof, parabola, DECISIVE_SHARE)
    is_told = np.sqrt(np.diag(free.estimate.covariance))[SIZE] < TOLD_SD_M
    spread = 1.0
    if alike > 1.0:
        spread = fit_tripod(frames, free.estimate, mean, sd, drawn, alike=alike, parts_m=np.inf).spread
    for hypothesis in USUAL_SIZES:
        usual_mean, usual_sd = _prior_of(hypothesis, is_told, mean, sd)
        roof, parabola = (fit_tripod(frames, f.estimate, usual_mean, usual_sd, drawn, alike=alike) for f in shaped)
        fixed = choose_surface(roof, parabola)
        if fixed.cost < free.cost:  # which a freer fit cannot be, but for the optimum that it found
            free = fit_tripod(frames, fixed.estimate, mean, sd, drawn, alike=alike)
        more_cost = fixed.cost - free.cost
        # a frame that contradicts the size is no false calibration
        loses = (fixed.clear_rms_px > limit_px) & (free.clear_rms_px <= limit_px)
        is_near = spread > 1.0 and more_cost < hypothesis.rough_cost * spread
        if more_cost < hypothesis.most_cost or (is_near and not loses.any()):
            return fixed, usual_mean, usual_sd
    return free, mean, sd


def choose_surface(usual: TripodFit, other: TripodFit, share: float = 0.0) -> TripodFit:
    """The fit before the usual surface, unless that before another costs less by that share of its cost and more."""
    return other if other.cost < (1.0 - share) * usual.cost - DECISIVE else usual


def joint_frames(frames: Sequence[HeadedFrame], drawn: DrawnTemplate) -> list[HeadedFrame]:
    """The frames that show the middle of the field; none where too few of them show an end in one picture with it."""
    by_length = drawn.shifts[:, 1, 0]
    counts = [np.bincount(frame.measured.marking, minlength=len(drawn.names)) for frame in frames]
    middle, end = (
        np.array([int(count[on].sum()) for count in counts])
        for on in (drawn.is_circle & (by_length == 0.0), by_length != 0.0)
    )
    shows_middle = middle >= JOINT_PLACES[0]
    if np.count_nonzero(shows_middle & (end >= JOINT_PLACES[1])) < JOINT_FRAMES:
        return []
    return [frame for frame, shows in zip(frames, shows_middle, strict=True) if shows]


def _prior_of(hypothesis: UsualSize, is_told: NDArray[np.bool_], mean: Array, sd: Array) -> tuple[Array, Array]:
    """Prior of what all frames share before a pitch of a usual size: certain where the frames tell the size."""
    is_usual = np.array(hypothesis.is_usual)
    usual_mean, usual_sd = mean.copy(), sd.copy()
    usual_mean[SIZE] = np.where(is_usual, 0.0, mean[SIZE])
    usual_sd[SIZE] = np.where(is_usual, np.where(is_told, 0.0, np.minimum(sd[SIZE], USUAL_SD_M)), sd[SIZE])
    return usual_mean, usual_sd


def hold_size(tripod: TripodEstimate, mean: Array, sd: Array) -> tuple[Array, Array]:
    """Prior (K,), (K,) of what all frames share, with the size of the pitch as a tripod leaves it: settled where it is
    certain, and near the usual one, so that place and lens follow it, where the frames of the tripod left it open.
    """
    size_sd = np.sqrt(np.diag(tripod.covariance)[SIZE])
    is_settled, is_open = size_sd == 0.0, (size_sd > TOLD_SD_M) & (size_sd <= USUAL_SD_M)
    is_usual = is_open & (np.abs(tripod.mean[SIZE]) < FAR_SIGMAS * USUAL_SD_M)
    mean, sd = mean.copy(), sd.copy()
    mean[SIZE] = np.select([is_settled, is_usual], [tripod.mean[SIZE], np.zeros(2)], mean[SIZE])
    sd[SIZE] = np.select([is_settled, is_usual], [0.0, USUAL_SD_M], sd[SIZE])
    return mean, sd


def untold_sizes(tripod: TripodEstimate, sd: Array) -> NDArray[np.bool_]:
    """Which sizes of the pitch (2,), of those that differ by the prior's standard deviations (K,), the frames of a
    tripod leave open.
    """
    return np.asarray((np.sqrt(np.diag(tripod.covariance)[SIZE]) > TOLD_SD_M) & (sd[SIZE] > 0.0), np.bool_)


def priors_of_sizes(
    tripod: TripodEstimate, mean: Array, sd: Array, shares: Mapping[Size, float]
) -> list[tuple[Array, Array, float]]:
    """Priors (K,), (K,) of what all frames share before a pitch of each kind of size that the frames leave possible,
    and how many pitches are of that kind.

    Parameters
    ----------
    tripod : TripodEstimate
        With what its frames tell of the size.
    mean, sd : (K,) arrays
        Prior before a pitch of any size, but for a size that is told.
    shares : mapping
        How many pitches are of the usual size, of another length alone and of any size.
    """
    is_untold = untold_sizes(tripod, sd)
    is_other = ~is_untold & ((sd[SIZE] > 0.0) | (mean[SIZE] != 0.0))
    shares_by_near: dict[tuple[bool, ...], float] = {}
    for size, share in shares.items():
        is_usual = np.array(are_usual(size))
        if not (is_usual & is_other).any():
            near = tuple((is_usual & is_untold).tolist())
            shares_by_near[near] = shares_by_near.get(near, 0.0) + share
    priors = []
    for near, share in shares_by_near.items():
        at = _at_sizes(np.array(near))
        priors.append((np.where(at, 0.0, mean), np.where(at, USUAL_SD_M, sd), share))
    return priors


def _at_sizes(chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of the common parameters (K,) are the chosen ones of the pitch's sizes (2,)."""
    at = np.zeros(len(COMMON), np.bool_)
    at[SIZE] = chosen
    return at


def mix_sizes(fits: Sequence[TripodFit], priors: Sequence[tuple[Array, Array, float]]) -> tuple[int, TripodEstimate]:
    """Which fit is the likeliest, and its tripod with the covariance of the mixture of all, each before a pitch of one
    kind of size.

    With the paint's own variance, the evidence of a fit is ``share exp(-cost / 2) sqrt(|C| / |P|)``, where C and P are
    the covariances of the sizes after and before the frames; what is likelier by less than hundred to one does not
    settle the size. A pitch 62.8 m wide that a camera which stands still shows with its far touchline was taken for the
    usual one, 15 px off (standard deviation 3 px): its frames tell 63.4 +- 1.1 m.

    Parameters
    ----------
    fits : sequence of TripodFit
        With the covariances that answers have.
    priors : sequence of (K,) array, (K,) array, float
        Means, standard deviations and share of pitches that each was made with.
    """
    spread = min(fits, key=lambda fit: fit.cost).spread
    evidence = np.array([
        np.log(share) - fit.cost_by(spread) / 2.0 + _log_volume(fit.estimate.covariance, sd)
        for fit, (_, sd, share) in zip(fits, priors, strict=True)
    ])  # fmt: skip
    weight = np.exp(evidence - evidence.max())
    weight[weight < UNLIKELY_SHARE] = 0.0
    weight /= weight.sum()
    best = int(np.argmax(weight))
    chosen = fits[best].estimate
    away = np.array([fit.estimate.mean - chosen.mean for fit in fits])
    covariances = np.array([fit.estimate.covariance for fit in fits])
    moments = covariances + away[:, :, None] * away[:, None, :]
    return best, replace(chosen, covariance=np.einsum("k,kij->ij", weight, moments))


def _log_volume(covariance: Array, sd: Array) -> float:
    """Logarithm of how much smaller frames make the room for the sizes of the pitch than it was before them."""
    free = [size for size in SIZE if sd[size] > 0.0]
    ratio = covariance[np.ix_(free, free)] / np.outer(sd[free], sd[free])
    return float(np.linalg.slogdet(ratio)[1] / 2.0)


def loosen_size(sd: Array, template: FieldTemplate) -> Array:
    """Standard deviations (K,) of what all frames share, where a size that is held at the usual one is only near it."""
    loose = sd.copy()
    is_open = np.array([extent.range_m is not None for extent in template.extents])
    loose[SIZE] = np.where(is_open, np.maximum(sd[SIZE], USUAL_SD_M), sd[SIZE])
    return loose


def open_size(held: TripodEstimate, loose: TripodEstimate, is_held: NDArray[np.bool_]) -> TripodEstimate:
    """A tripod with sizes of the pitch that are held, as uncertain as its own paint leaves these.

    The fit with sizes that are only near the held ones tells how uncertain they are by themselves, and how far they
    would lie away; both, as one mean square, belong to the held sizes and to all that follows them. Of fourteen real
    grounds whose size was held, the paint tells it to 0.07 to 0.5 m, and to a metre where no touchline is seen: one of
    100.1 by 68.3 m is held at 68 m, which its own paint has to 0.12 m, and one of 103 by 67 m at 68 m, which it does
    not show at all.

    Parameters
    ----------
    held, loose : TripodEstimate
        The fit with sizes that are held, and the one with sizes near them.
    is_held : (K,) array of bool
        Which parameters these sizes are.
    """
    away = loose.mean - held.mean
    told = loose.covariance[np.ix_(is_held, is_held)]
    follows = np.linalg.solve(told, loose.covariance[is_held])
    return replace(held, covariance=held.covariance + follows.T @ told @ follows + np.outer(away, away))


def leave_out_false_line(
    frames: list[HeadedFrame], starts: Sequence[TripodEstimate], mean: Array, sd: Array, drawn: DrawnTemplate
) -> tuple[list[HeadedFrame], list[TripodFit]]:
    """Frames without the one line round the field that is to blame for what the models leave beyond noise, or for much
    of it where the line is far, and their fits from each start; as they are, where no line is.

    In its place the foot of the boards was found, or where the grass changes its colour. The fits are made as if no two
    frames had an error of the models in common.
    """

    def fit(seen: list[HeadedFrame]) -> list[TripodFit]:
        return [fit_tripod(seen, start, mean, sd, drawn) for start in starts]

    def is_far(line: int) -> bool:
        scales = np.concatenate([frame.measured.scale_px_m[frame.measured.marking == line] for frame in frames])
        return bool(np.median(scales) < CLEAR_PX_M * starts[0].size[0] / 1920.0)

    fits = fit(frames)
    excess, best = min(map(excess_of, fits)), (frames, fits)
    least = excess
    if excess > 0.0:
        seen = np.unique(np.concatenate([frame.measured.marking for frame in frames]))
        for line in np.intersect1d(drawn.border, seen).tolist():
            others = [replace(frame, measured=frame.measured.leave_out(line)) for frame in frames]
            fits_of_others = fit(others)
            left = min(map(excess_of, fits_of_others))
            if left < least and left <= (EXCESS_LEFT * excess if excess > 1.0 and is_far(line) else 0.0):
                least, best = left, (others, fits_of_others)
    return best


def _of_shapes(tripod: TripodEstimate, shapes: Sequence[SurfaceShape]) -> list[TripodEstimate]:
    """A tripod before surfaces of other shapes."""
    return [replace(tripod, surface=replace(tripod.surface, shape=shape)) for shape in shapes]


def search_length(
    tripod: TripodEstimate,
    members: Sequence[HeadedFrame],
    pictures: Mapping[str, LookedAt],
    template: FieldTemplate,
) -> TripodEstimate | None:
    """The tripod before a pitch of the length at which the penalty areas show the most paint; None where the length is
    known, or none shows clearly more than the others.
    """
    extent = template.length_range_m
    if extent is None or tripod.sigma("length") < OPEN_SD_M:
        return None
    by_pan = sorted(members, key=lambda frame: float(frame.head[1]))
    outer = {frame.name: frame for frame in (*by_pan[:OUTER_FRAMES], *by_pan[-OUTER_FRAMES:])}
    growths = np.arange(extent[0], extent[1] + LENGTH_STEP_M / 2.0, LENGTH_STEP_M) - template.length_m
    worth = np.array([_worth_of_length(g, tripod, outer, pictures, template) for g in growths])
    best = int(np.argmax(worth))
    if worth[best] < float(np.median(worth)) + LEAST_MORE_WORTH:
        return None
    return hold_size_at(tripod, "length", float(growths[best]), LENGTH_SD_M)


def _worth_of_length(
    growth_m: float,
    tripod: TripodEstimate,
    frames: Mapping[str, HeadedFrame],
    pictures: Mapping[str, LookedAt],
    template: FieldTemplate,
) -> float:
    """How much paint frames show of a pitch that is longer than the template's."""
    place = Place.of(hold_size_at(tripod, "length", growth_m, LENGTH_SD_M), template)
    looks = (place.look(pictures[n], f.head, place.proposal_covariance(f.head)) for n, f in frames.items())
    return sum(look.worth for look in looks)


def search_width(
    tripod: TripodEstimate,
    members: Sequence[HeadedFrame],
    pictures: Mapping[str, LookedAt],
    template: FieldTemplate,
) -> TripodEstimate | None:
    """The tripod before a pitch of the width at which whole touchlines show; None where the width is known, or none
    shows so.
    """
    if tripod.sigma("breadth") < OPEN_SD_M:
        return None
    width = find_width(tripod, members, pictures, template)
    return None if width is None else hold_size_at(tripod, "breadth", width - template.width_m, WIDTH_SD_M)


def hold_size_at(tripod: TripodEstimate, name: str, growth_m: float, sd_m: float) -> TripodEstimate:
    """The tripod before a pitch that is longer or broader than the template's by so much, with what is left open."""
    size = PLACE[name]
    mean, covariance = tripod.mean.copy(), tripod.covariance.copy()
    mean[size] = growth_m
    covariance[size] = covariance[:, size] = 0.0
    covariance[size, size] = sd_m**2
    return replace(tripod, mean=mean, covariance=covariance)
