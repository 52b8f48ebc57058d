"""One circle hypothesis in the full picture: measured, fitted, judged.

The gates were set on 42 broadcast frames with the circle, 244 pictures without one and 102 crops of penalty areas. Of
the right circles the picture showed a share of at least 0.81, the field of 0.84, and at least 0.44 of the whole was
drawn (0.54 with a halfway line); of the wrong ones the smaller of picture and field share was at most 0.68, and a
penalty arc is 0.28 to 0.35 of the whole ellipse.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from circlecal.checks import CHECKS
from circlecal.detection.ellipse_batch import EllipseBatch, adjust_ellipses, ellipse_conic, unit_frame
from circlecal.detection.options import AcceptanceConfig, ProfilesConfig
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array, Mask, lift, normalise_line, transform_lines
from circlecal.paint.bands import MeasuredCurve, measure_curve
from circlecal.pictures.graphics import lie_under
from circlecal.results import Check

__all__ = [
    "LEAST_FIRST_SHARE",
    "CircleHypothesis",
    "MeasuredCircle",
    "check_circle",
    "describe_circle",
    "find_refusal",
    "hide_samples",
    "is_drawn_on_both_sides",
    "is_tentative",
    "may_be_faint",
    "measure_circle",
]

SPACING_PX = 3.0
"""Distance between profiles along a curve, pixels at 1920 px width."""
MOST_PROFILES, FEWEST_PROFILES = 640, 64
"""On one circle, which bound the time of large ones and the scatter of small ones."""
ROUNDS = 2
"""Of profiles and fit, the first on every other sample."""
LEAST_REACH_PX = 3.0
"""Half length of a profile in pixels of the picture, which both sides of the paint need in small pictures."""
LEAST_FIRST_SHARE = 0.08
"""Share of the samples in the picture that show a marking in the first round below which there is no second one: of
1,569 ellipses in 81 real pictures of several sports 410 had less, and none of these was a circle or an arc.
"""
FEWEST_TO_FIT = 12
"""Samples that move the ellipse between two rounds; five fix it."""
_KNOTS = np.arange(361) * (2 * np.pi / 360)
_SINES, _COSINES = (f((_KNOTS[:-1] + _KNOTS[1:]) / 2) for f in (np.sin, np.cos))
PIECES = 8
"""Of the curve, between which the contrast may differ: that of the far side is 40 to 80 % of that of the near side."""

NEARLY_WHOLE = 0.60
"""Share of the whole circle that is drawn from which on it is nearly whole: with a halfway line it may then be hidden
more, and for its band both the wide and the narrow parts are seen."""
LEAST_RMS_PX = 1.8
"""Residual, pixels at 1920 px width, that any circle may have: a crowned pitch leaves 0.3 to 1.1 in broadcasts."""
SMALL_PICTURE_RMS_PX = 0.5
"""Residual in pixels of the picture that a nearly whole circle with a halfway line may always have, however small the
picture is."""
THINNEST_BAND = 0.005
"""Smallest width of the band on the field, in radii; paint of 10 to 12 cm on a circle of 9.15 m is 0.011 to 0.013, a
ring that is drawn into the picture is as wide everywhere and shows 0.
"""
TENTATIVE_SHARE = 0.5
"""Smallest share of the visible circle that is drawn, where something else must confirm it: worn, mostly hidden."""
TENTATIVE_PAINTED_SHARE = 0.55
"""Smallest share of its sectors in which paint stands out on average, for faint paint which single places do not show;
ellipses stitched from streaks have less than half."""
LEAST_FAINT_SHARE = 0.3
"""Share of the part inside the picture where single places show a marking, below which no faint paint is looked for: of
1,528 ellipses in real and rendered pictures of all sports it stood out in so many sectors of 37, which show 0.37 or
more; 576 show less than 0.3.
"""
TENTATIVE_WHOLE_SHARE = 0.14
"""Smallest share of the whole ellipse that is drawn, where something else must confirm it."""

CLEAR_OF_LINE = 0.05
"""Radii from a line within which a sample belongs to no side of it."""
SIDE_SHARE = 0.02
"""Smallest share of the whole on either side of the halfway line, where the picture shows more than twice as much of
it; a penalty arc has one side only.
"""
HIDDEN_SHARE = 0.07
"""Share of the circle that players may hide altogether."""
END_SHARE = 0.3
"""Share of the way from the small to the great half axis: what counts as an end of the width's range."""
WIDEST = 0.97
"""Share of the samples that are narrower than what counts as the greatest width."""
FEWEST_AT_ENDS = 6
"""Samples at either end of the width's range, whose median is its width."""
NEARER_WIDER = 1.3
"""Width of the nearer flat part over that of the farther one from which on perspective shows: of 99 rings that were
drawn into pictures it is 1.02 at most, of three robots' circles, whose near part is wider than the sides, 3 to 4.
"""
NARROWEST_RADII, TELLING_PX = 0.008, 2.5
"""A marking this narrow, in radii, must differ by so many pixels between the ends for its width to be told."""


@dataclass(frozen=True, slots=True)
class CircleHypothesis:
    """An ellipse that may be the image of the circle, and what speaks for it.

    Attributes
    ----------
    conic : (3, 3) float64
        Normalised conic through the middle of the marking, px.
    score : float
        Order among the hypotheses; larger is better.
    whole_share : float
        Share of the whole circle (by eccentric angle) where the picture shows a marking.
    field_share : float
        Share of the part inside the field that lies on ridge points of its direction.
    picture_share : float
        Share of the part inside the picture (by length) where the picture shows a marking.
    sector_share : float
        Share of the visible part (by eccentric angle) where the picture shows a marking.
    rms_px : float
        Scatter of the marking's middle about the conic, in px at 1920 px width.
    points : (N, 2) float64
        Measured middle of the marking, px.
    band_width : float or None
        Width of the band on the field in radii of the circle, from how much wider it is where the circle is seen
        broadside than near and far; None where that cannot be told.
    painted_share : float
        Share of the visible sectors in which paint stands out on average, where single places show too little; else 0.
    checks : tuple of Check
        The gates that it was held against.
    """

    conic: Array
    score: float
    whole_share: float
    field_share: float
    picture_share: float
    sector_share: float
    rms_px: float
    points: Array
    band_width: float | None = None
    painted_share: float = 0.0
    checks: tuple[Check, ...] = ()

    @property
    def least_share(self) -> float:
        """The smallest of the shares of what is seen of it."""
        return min(self.picture_share, self.field_share, self.sector_share)


@dataclass(frozen=True, slots=True)
class MeasuredCircle:
    """An ellipse (a batch of one) with what was measured at equal steps along it.

    ``angle_share`` (N,) is each sample's part of the whole eccentric angle; it adds up to one.
    """

    ellipse: EllipseBatch
    angle_share: Array
    curve: MeasuredCurve
    sign: float

    @property
    def seen_share(self) -> float:
        """Share of the samples in the picture that show a marking."""
        return float(np.count_nonzero(self.curve.supported)) / max(1, int(np.count_nonzero(self.curve.inside)))

    @property
    def widest_px(self) -> float:
        """Width of the marking where it is widest; 0 where it is not seen."""
        width = np.sort(self.curve.width[self.curve.supported])
        return float(width[int(WIDEST * len(width))]) if len(width) else 0.0


def measure_circle(
    gray: NDArray[np.uint8], ellipse: EllipseBatch, sign: float, config: ProfilesConfig
) -> MeasuredCircle:
    """Follow the marking along an ellipse and fit the ellipse to it, in a few rounds, or in one where it shows nothing.

    Parameters
    ----------
    gray : (H, W) uint8
        Full picture.
    ellipse : EllipseBatch
        One ellipse in pixels of the full picture.
    sign : float
        +1 for a marking lighter than the surface, -1 for a darker one.
    config : ProfilesConfig

    Returns
    -------
    MeasuredCircle
    """
    width = gray.shape[1]
    for turn in range(ROUNDS):
        reach = (config.reach_px if turn == 0 else config.narrow_reach_px) * width / 1920.0
        # until the last round the ellipse is only moved to the marking: every other sample will do
        step = 2 if turn + 1 < ROUNDS else 1
        points, normals, share = _space_evenly(ellipse, step * SPACING_PX * width / 1920.0, MOST_PROFILES // step)
        depth = np.abs(((points - ellipse.centers[0]) * normals).sum(axis=-1))
        reaches = max(reach, LEAST_REACH_PX) + config.width_share * depth
        pieces = np.arange(len(points)) * PIECES // len(points)
        circle = MeasuredCircle(ellipse, share, measure_curve(gray, points, normals, reaches, pieces, sign), sign)
        if circle.seen_share < LEAST_FIRST_SHARE:
            break
        marking = circle.curve.marking_points
        if turn + 1 < ROUNDS and len(marking) >= FEWEST_TO_FIT:
            ellipse = adjust_ellipses(ellipse, marking[None], np.ones((1, len(marking))))
    return circle


def hide_samples(circle: MeasuredCircle, covered: Mask | None) -> MeasuredCircle:
    """The circle without the samples that graphics cover (H, W): they are as good as outside the picture."""
    if covered is None:
        return circle
    seen = ~lie_under(circle.curve.points, covered)
    curve = replace(circle.curve, inside=circle.curve.inside & seen, supported=circle.curve.supported & seen)
    return replace(circle, curve=curve)


def _space_evenly(ellipse: EllipseBatch, spacing_px: float, most: int) -> tuple[Array, Array, Array]:
    """Points and outward normals (N, 2) at equal distances along the ellipse, and their share of the angle."""
    great, small = float(ellipse.great_lengths[0]), float(ellipse.small_lengths[0])
    speed = np.hypot(great * _SINES, small * _COSINES) * (2 * np.pi / 360)
    length = np.concatenate([[0.0], np.cumsum(speed)])
    count = int(min(max(length[-1] / spacing_px, FEWEST_PROFILES), most))
    edges = np.interp(np.arange(count + 1) * (length[-1] / count), length, _KNOTS)
    angle = (edges[:-1] + edges[1:]) / 2
    cosine, sine = np.cos(angle), np.sin(angle)
    # whole rows of x and of y
    center, great_axis, small_axis = ellipse.centers[0, :, None], ellipse.great[0, :, None], ellipse.small[0, :, None]
    points = center + cosine * great_axis + sine * small_axis
    x, y = cosine * small_axis - sine * great_axis
    length_px = np.hypot(x, y)
    normals = np.array([y / length_px, -(x / length_px)])
    off = points - center
    normals *= np.sign(off[0] * normals[0] + off[1] * normals[1])
    return points.T.copy(), normals.T.copy(), np.diff(edges) / (2 * np.pi)


def describe_circle(circle: MeasuredCircle, field_share: float, width: int) -> CircleHypothesis:
    """Shares, residual and conic of a measured circle in a picture of the given width."""
    curve = circle.curve
    on = curve.supported
    visible = float(circle.angle_share[curve.inside].sum())
    whole = float(circle.angle_share[on].sum())
    picture_share = circle.seen_share
    rms = float(np.sqrt(np.mean(curve.offset[on] ** 2))) if on.any() else float("inf")
    return CircleHypothesis(
        conic=ellipse_conic(circle.ellipse),
        score=whole * np.sqrt(max(0.0, min(picture_share, field_share))),
        whole_share=whole,
        field_share=field_share,
        picture_share=picture_share,
        sector_share=whole / visible if visible > 0 else 0.0,
        rms_px=rms * 1920.0 / width,
        points=curve.marking_points,
        band_width=measure_band_width(circle),
    )


def is_drawn_on_both_sides(circle: MeasuredCircle, line: Array) -> bool:
    """Whether the circle is drawn on both sides of a line (3,) where the picture shows it.

    A side of which the picture shows hardly anything, or what a player or two may hide, is not judged.
    """
    to_unit = np.linalg.inv(unit_frame(circle.ellipse))
    local = normalise_line(transform_lines(to_unit, line))
    distance = lift(circle.curve.points) @ to_unit.T @ local
    on, inside = circle.curve.supported, circle.curve.inside
    for side in (-1.0, 1.0):
        beyond = side * distance > CLEAR_OF_LINE
        seen, drawn = (float(circle.angle_share[part & beyond].sum()) for part in (inside, on))
        if seen > max(2 * SIDE_SHARE, HIDDEN_SHARE) and drawn < SIDE_SHARE:
            return False
    return True


def is_tentative(circle: CircleHypothesis, width: int, config: AcceptanceConfig) -> bool:
    """Whether a circle of a picture of this width that is not accepted by itself may be the one, should another marking
    at its place, or the centre mark, confirm it: worn, mostly hidden, or a short arc.
    """
    if not config.even_width and circle.band_width is not None and circle.band_width < THINNEST_BAND:
        return False
    if circle.rms_px > _largest_rms(circle, width, config) or circle.whole_share < TENTATIVE_WHOLE_SHARE:
        return False
    return circle.least_share >= TENTATIVE_SHARE or circle.painted_share >= TENTATIVE_PAINTED_SHARE


def may_be_faint(circle: CircleHypothesis, width: int, config: AcceptanceConfig) -> bool:
    """Whether a circle of a picture of this width would be tentative if its paint stood out in sectors where single
    places show too little.
    """
    if circle.picture_share < LEAST_FAINT_SHARE or is_tentative(circle, width, config):
        return False
    return is_tentative(replace(circle, painted_share=1.0), width, config)


def _largest_rms(circle: CircleHypothesis, width: int, config: AcceptanceConfig) -> float:
    """Largest residual, pixels at 1920 px width, of a circle of this size: the larger, the more of a surface that is
    not flat it shows.
    """
    ellipse = ellipse_from_conic(circle.conic)
    great = 0.0 if ellipse is None else ellipse.semi_axes[0]
    return max(LEAST_RMS_PX, max(SMALL_PICTURE_RMS_PX, config.rms_share * great) * 1920.0 / width)


def measure_band_width(circle: MeasuredCircle) -> float | None:
    """Width of the band in radii of the circle: paint on the field is wide where the circle is seen broadside and
    narrow near and far, a ring drawn into the picture is as wide everywhere. None where the two cannot be told apart.

    The blur adds in squares, and to all widths alike. A part of a circle may show its near side only, which
    perspective widens. From near and low the near part may be wider than the sides; the far part stands for the flat
    ones then, which no ring that is as wide everywhere asks for.
    """
    curve, on = circle.curve, circle.curve.supported
    reach = np.abs(((curve.points - circle.ellipse.centers[0]) * curve.normals).sum(axis=-1))
    great, small = float(circle.ellipse.great_lengths[0]), float(circle.ellipse.small_lengths[0])
    share = (reach - small) / max(great - small, 1e-9)
    broadside, flat = on & (share > 1.0 - END_SHARE), on & (share < END_SHARE)
    drawn = float(circle.angle_share[on].sum())
    if drawn < NEARLY_WHOLE or min(np.count_nonzero(broadside), np.count_nonzero(flat)) < FEWEST_AT_ENDS:
        return None
    ends = [flat & (side * (curve.points[:, 1] - circle.ellipse.centers[0, 1]) > 0.0) for side in (-1.0, 1.0)]
    if min(np.count_nonzero(end) for end in ends) >= FEWEST_AT_ENDS:
        far, near = sorted(ends, key=lambda end: float(np.median(curve.width[end])))
        if np.median(curve.width[near]) > NEARER_WIDER * np.median(curve.width[far]):
            flat = far
    wide, narrow = (float(np.median(curve.width[part])) for part in (broadside, flat))
    lever = float(np.median(reach[broadside]) ** 2 - np.median(reach[flat]) ** 2)
    if lever <= 0 or NARROWEST_RADII * np.sqrt(lever) < TELLING_PX:
        return None
    return float(np.sqrt(max(0.0, wide**2 - narrow**2) / lever))


def check_circle(
    circle: CircleHypothesis, has_halfway: bool, width: int, config: AcceptanceConfig
) -> tuple[Check, ...]:
    """The gates of a circle in a picture of the given width, by the names under which refusals know them.

    Parameters
    ----------
    circle : CircleHypothesis
    has_halfway : bool
        Whether a halfway line passes through its middle.
    width : int
        Of the full picture, px.
    config : AcceptanceConfig
    """
    is_nearly_whole = circle.whole_share >= NEARLY_WHOLE
    share, rms = config.share, LEAST_RMS_PX
    if is_nearly_whole and has_halfway:
        share, rms = config.share_with_line, _largest_rms(circle, width, config)
    elif not is_nearly_whole and not has_halfway:
        share = config.share_of_lone_arc
    whole = config.whole_share_with_line if has_halfway else config.whole_share
    band = None if config.even_width else circle.band_width
    return (
        Check.of("marking_rms_px", circle.rms_px, rms),
        *(() if band is None else (Check.of("band_width", band, THINNEST_BAND),)),
        Check.of("painted_share", circle.least_share, share),
        Check.of("whole_share", circle.whole_share, whole),
    )


def find_refusal(checks: tuple[Check, ...]) -> str | None:
    """Code of the first gate that is not passed, or None."""
    return next((CHECKS[check.name].code for check in checks if not check.passed), None)
