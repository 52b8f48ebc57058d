"""One circle hypothesis at full resolution: measured, fitted, judged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.hypotheses import EllipseBatch
from circlecal.detection.options import AcceptanceConfig, LikelyConfig
from circlecal.detection.scoring import adjusted
from circlecal.geometry.conics import transform_conic
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array, lift, normalise_line, transform_lines
from circlecal.paint.bands import BandProfile, RefinementConfig, measure_band

__all__ = [
    "CircleHypothesis",
    "MeasuredCircle",
    "conic_of",
    "drawn_on_both_sides",
    "hypothesis_of",
    "likely_arc",
    "measure_circle",
    "refusal_of",
    "unit_frame",
]

_PIECES = 8  # of the curve, between which the contrast may differ (near and far side)
_CLEAR = 0.05  # radii from the line within which a sample belongs to no side
_END_SHARE = 0.3  # of the way from the small to the great half axis: what counts as an end of the width's range
_WIDEST = 0.97  # share of the samples that are narrower than what counts as the greatest width
_FEWEST = 6  # samples at either end
_NEARLY_WHOLE = 0.6  # share of the circle that is drawn, for the widths of both sides to be seen
_NARROWEST_RADII, _TELLING_PX = 0.008, 2.5  # a marking this narrow must differ by so much for its width to be told
_HIDDEN = 0.07  # share of the circle that players may hide altogether
_UNIT_CIRCLE = np.diag([1.0, 1.0, -1.0])


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

    @property
    def least_share(self) -> float:
        """The smallest of the shares of what is seen of it."""
        return min(self.picture_share, self.field_share, self.sector_share)


@dataclass(frozen=True, slots=True)
class MeasuredCircle:
    """An ellipse (a batch of one) with its profiles at equal steps along the curve.

    ``angle_share`` (N,) is each sample's part of the whole eccentric angle; it adds up to one.
    """

    ellipse: EllipseBatch
    points: Array
    normals: Array
    angle_share: Array
    band: BandProfile
    sign: float

    @property
    def marking_points(self) -> Array:
        """Measured middle of the marking (K, 2), px."""
        on = self.band.supported
        return self.points[on] + self.band.offset[on, None] * self.normals[on]

    @property
    def widest_px(self) -> float:
        """Width of the marking where it is widest; 0 where it is not seen."""
        width = np.sort(self.band.width[self.band.supported])
        return float(width[int(_WIDEST * len(width))]) if len(width) else 0.0


def unit_frame(ellipse: EllipseBatch) -> Array:
    """Affinity (3, 3) from the frame in which the first ellipse is the unit circle to the picture."""
    frame = np.eye(3)
    frame[:2, 0], frame[:2, 1], frame[:2, 2] = ellipse.great[0], ellipse.small[0], ellipse.centers[0]
    return frame


def conic_of(ellipse: EllipseBatch) -> Array:
    """Normalised conic (3, 3) of the first ellipse of a batch."""
    return transform_conic(unit_frame(ellipse), _UNIT_CIRCLE)


def measure_circle(
    grey: NDArray[np.uint8], ellipse: EllipseBatch, sign: float, config: RefinementConfig
) -> MeasuredCircle:
    """Follow the marking along an ellipse and fit the ellipse to it, in a few rounds.

    Parameters
    ----------
    grey : (H, W) uint8
        Full picture.
    ellipse : EllipseBatch
        One ellipse in pixels of the full picture.
    sign : float
        +1 for a marking lighter than the surface, -1 for a darker one.
    config : RefinementConfig

    Returns
    -------
    MeasuredCircle
    """
    unit = grey.shape[1] / 1280.0
    for turn in range(config.rounds):
        reach = (config.reach_px1280 if turn == 0 else config.narrow_reach_px1280) * unit
        # until the last round the ellipse is only moved to the marking: every other sample will do
        step = 2 if turn + 1 < config.rounds else 1
        points, normals, share = _equal_steps(ellipse, step * config.spacing_px1280 * unit, config.samples // step)
        depth = np.abs(((points - ellipse.centers[0]) * normals).sum(axis=-1))
        reaches = max(reach, 3.0) + config.width_share * depth
        pieces = np.arange(len(points)) * _PIECES // len(points)
        band = measure_band(grey, points, normals, reaches, pieces, sign, config)
        circle = MeasuredCircle(ellipse, points, normals, share, band, sign)
        marking = circle.marking_points
        if turn + 1 < config.rounds and len(marking) >= 12:
            ellipse = adjusted(ellipse, marking[None], np.ones((1, len(marking))))
    return circle


def _equal_steps(ellipse: EllipseBatch, spacing_px: float, most: int) -> tuple[Array, Array, Array]:
    """Points and outward normals (N, 2) at equal distances along the ellipse, and their share of the angle."""
    knots = np.arange(361) * (2 * np.pi / 360)
    great, small = float(ellipse.great_lengths[0]), float(ellipse.small_lengths[0])
    middle = (knots[:-1] + knots[1:]) / 2
    speed = np.hypot(great * np.sin(middle), small * np.cos(middle)) * (2 * np.pi / 360)
    length = np.concatenate([[0.0], np.cumsum(speed)])
    count = int(np.clip(length[-1] / spacing_px, 64, most))
    edges = np.interp(np.arange(count + 1) * (length[-1] / count), length, knots)
    angle = (edges[:-1] + edges[1:]) / 2
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    points = ellipse.centers[0] + cosine * ellipse.great[0] + sine * ellipse.small[0]
    tangent = cosine * ellipse.small[0] - sine * ellipse.great[0]
    tangent /= np.hypot(tangent[:, :1], tangent[:, 1:])
    normals = np.stack([tangent[:, 1], -tangent[:, 0]], axis=-1)
    normals *= np.sign(((points - ellipse.centers[0]) * normals).sum(axis=-1, keepdims=True))
    return points, normals, np.diff(edges) / (2 * np.pi)


def hypothesis_of(circle: MeasuredCircle, field_share: float, width: int) -> CircleHypothesis:
    """Shares, residual and conic of a measured circle in a picture of the given width."""
    band = circle.band
    on = band.supported
    seen = max(1, int(np.count_nonzero(band.inside)))
    visible = float(circle.angle_share[band.inside].sum())
    whole = float(circle.angle_share[on].sum())
    picture_share = float(np.count_nonzero(on)) / seen
    rms = float(np.sqrt(np.mean(band.offset[on] ** 2))) if on.any() else float("inf")
    return CircleHypothesis(
        conic=conic_of(circle.ellipse),
        score=whole * np.sqrt(max(0.0, min(picture_share, field_share))),
        whole_share=whole,
        field_share=field_share,
        picture_share=picture_share,
        sector_share=whole / visible if visible > 0 else 0.0,
        rms_px=rms * 1920.0 / width,
        points=circle.marking_points,
        band_width=band_width_of(circle),
    )


def drawn_on_both_sides(circle: MeasuredCircle, line: Array, share: float) -> bool:
    """Whether the circle is drawn on both sides of a line (3,), by ``share`` of the whole, where the picture shows it.

    A side of which the picture shows less than twice that much, or what a player or two may hide, is not judged.
    """
    to_unit = np.linalg.inv(unit_frame(circle.ellipse))
    local = normalise_line(transform_lines(to_unit, line))
    distance = lift(circle.points) @ to_unit.T @ local
    on, inside = circle.band.supported, circle.band.inside
    for side in (-1.0, 1.0):
        beyond = side * distance > _CLEAR
        seen, drawn = (float(circle.angle_share[part & beyond].sum()) for part in (inside, on))
        if seen > max(2 * share, _HIDDEN) and drawn < share:
            return False
    return True


def likely_arc(circle: CircleHypothesis, width: int, acceptance: AcceptanceConfig, config: LikelyConfig) -> bool:
    """Whether a circle that is not accepted by itself may be the one, should something else confirm it."""
    ellipse = ellipse_from_conic(circle.conic)
    great = 0.0 if ellipse is None else ellipse.semi_axes[0]
    rms = max(acceptance.rms_px1920, max(acceptance.rms_px, acceptance.rms_share * great) * 1920.0 / width)
    if circle.band_width is not None and circle.band_width < acceptance.band_width:
        return False
    painted = circle.least_share >= config.share or circle.painted_share >= config.painted_share
    return circle.rms_px <= rms and painted and circle.whole_share >= config.whole_share


def band_width_of(circle: MeasuredCircle) -> float | None:
    """Width of the band in radii of the circle: paint on the field is wide where the circle is seen broadside and
    narrow near and far, a ring drawn into the picture is as wide everywhere. None where the two cannot be told apart.

    The blur adds in squares, and to all widths alike. A part of a circle may show its near side only, which
    perspective widens.
    """
    on = circle.band.supported
    reach = np.abs(((circle.points - circle.ellipse.centers[0]) * circle.normals).sum(axis=-1))
    great, small = float(circle.ellipse.great_lengths[0]), float(circle.ellipse.small_lengths[0])
    share = (reach - small) / max(great - small, 1e-9)
    broadside, flat = on & (share > 1.0 - _END_SHARE), on & (share < _END_SHARE)
    drawn = float(circle.angle_share[on].sum())
    if drawn < _NEARLY_WHOLE or min(np.count_nonzero(broadside), np.count_nonzero(flat)) < _FEWEST:
        return None
    wide, narrow = (float(np.median(circle.band.width[part])) for part in (broadside, flat))
    lever = float(np.median(reach[broadside]) ** 2 - np.median(reach[flat]) ** 2)
    if lever <= 0 or _NARROWEST_RADII * np.sqrt(lever) < _TELLING_PX:
        return None
    return float(np.sqrt(max(0.0, wide**2 - narrow**2) / lever))


def refusal_of(circle: CircleHypothesis, has_halfway: bool, width: int, config: AcceptanceConfig) -> str | None:
    """Why this circle of a picture of the given width is not accepted, or None."""
    nearly_whole = circle.whole_share >= config.complete_share
    share, rms = config.share, config.rms_px1920
    if nearly_whole and has_halfway:
        ellipse = ellipse_from_conic(circle.conic)
        great = 0.0 if ellipse is None else ellipse.semi_axes[0]
        share, rms = config.share_with_line, max(rms, max(config.rms_px, config.rms_share * great) * 1920.0 / width)
    elif not nearly_whole and not has_halfway:
        share = config.share_of_lone_arc
    if circle.rms_px > rms:
        return "circle_off_marking"
    if circle.band_width is not None and circle.band_width < config.band_width:
        return "width_unlike_marking"
    if circle.least_share < share:
        return "circle_support_too_low"
    if circle.whole_share < (config.whole_share_with_line if has_halfway else config.whole_share):
        return "arc_too_short"
    return None
