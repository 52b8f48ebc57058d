"""A camera that turns on a tripod: what all its frames share, what is each frame's own, and the derivatives of that.

The pan axis stands nearly upright at a point A and leans by the rotation ``L = Rx(lean_x) Ry(lean_y)``. On the head the
camera pans, tilts and rolls, so that the world-to-camera rotation is ``R = R(pan, tilt, roll) L^T``. Its entrance pupil
lies before the axes, at ``C = A + (lever + lever_by_zoom z) R^T (0, 0, 1)``, where z is the logarithm of the focal
length over the reference. Principal point and first radial coefficient are linear in z as well, the latter with the
bend of a zoom lens (:class:`circlecal.camera.priors.ZoomLens`) beside that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from circlecal.camera.priors import ZoomLens
from circlecal.errors import InputError
from circlecal.field.view import FieldView
from circlecal.geometry.camera import lens_factor, rotations_by
from circlecal.geometry.camera_parameters import (
    ANGLES,
    CROWN,
    INDEX,
    KAPPA,
    KAPPA_1,
    LOG_ASPECT,
    LOG_FOCAL,
    PARAMETERS,
    POSITION,
    PRINCIPAL,
    ProjectionModel,
    camera_of,
)
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import Surface

COMMON = (
    "axis_x", "axis_y", "axis_z", "lean_x", "lean_y", "head_roll", "lever", "lever_by_zoom",
    "pp_x", "pp_y", "pp_x_by_zoom", "pp_y_by_zoom", "kappa_1", "kappa_1_by_zoom", "kappa_2", "log_aspect",
    "crown", "width", "length", "breadth", "kappa_1_by_focal",
)  # fmt: skip
"""Parameters of the tripod, its lens and its pitch: metres, radians, pixels, half-widths; ``by_zoom`` per unit of the
logarithm of the focal length. The sizes are offsets from the template's. ``kappa_1_by_focal`` is the b of
``-b (width / f)^2``, along which the first radial coefficient bends beside its linear change; 0 for that alone.
"""
PLACE = {name: k for k, name in enumerate(COMMON)}
_PIXELS = frozenset({"pp_x", "pp_y", "pp_x_by_zoom", "pp_y_by_zoom"})
_ROWS = "pp_y", "pp_y_by_zoom"
SAME_SHAPE = 1e-3
"""Shapes of pixels that differ by less are written with other digits: a row of a thousand is one pixel longer."""
SAME_FRAMING = 0.05
"""Share by which the shape of pictures may differ from that of a camera's: 704 and 720 columns of digital television
show one picture and differ by 2.3 %; 4:3, 16:10 and 16:9 are other cuts, and differ by 11 % at least.
"""
_DIRECT = ("pp_x", "pp_y", "kappa_1", "kappa_2", "log_aspect", "crown", "width", "length", "breadth")
_ZOOMED = ("pp_x", "pp_y", "kappa_1")
_LENS = (*_ZOOMED, *(f"{name}_by_zoom" for name in _ZOOMED), "kappa_2", "log_aspect")
_TO = np.array([INDEX[name] for name in _DIRECT])
_FROM = np.array([PLACE[name] for name in _DIRECT])
_ZOOM_TO = np.array([INDEX[name] for name in _ZOOMED])
_ZOOM_FROM = np.array([PLACE[f"{name}_by_zoom"] for name in _ZOOMED])
_AXIS, _LEAN, _LEVER = slice(0, 3), slice(3, 5), slice(6, 8)
_LEAST_AHEAD = 0.1
"""Of a direction that was on the optical axis before the head turned: no head turns by 84 degrees between frames."""
LEAST_TO_MIDDLE_RAD = -0.63 * np.pi
"""From which on directions to the middle of the field are counted, so that those of two estimates of one place hardly
ever differ by a turn: between the places of cameras behind a goal and of those beyond a corner of the far side.
"""
_ROLL, _BLOOM, _BY_FOCAL = PLACE["head_roll"], INDEX["bloom"], PLACE["kappa_1_by_focal"]


@dataclass(frozen=True, slots=True)
class TripodModel:
    """From own and common parameters to the camera's.

    Attributes
    ----------
    projection : ProjectionModel
        Size of the pictures, and profile of the surface.
    log_focal : float
        Logarithm of the focal length in pixels at which lever, principal point and lens are quoted.
    """

    projection: ProjectionModel
    log_focal: float

    def thetas(self, own: Array, common: Array) -> Array:
        """Parameter vectors of cameras (F, P) from own (F, O) and common (K,) or (F, K) parameters."""
        rotation = self.rotations(own, common)
        return self._thetas(own, _spread(common, own), rotation, angles_of(rotation))

    def linearise(self, own: Array, common: Array) -> tuple[Array, Array, Array]:
        """:meth:`thetas`, and their derivatives by the own (F, P, O) and by the common parameters (F, P, K).

        A rotation changes by ``dR = -[w]x R`` with w in camera coordinates: for each angle the axis about which it
        turns. The camera's own angles turn about three axes E, so they change by ``E^-1 w``.
        """
        on_head = self._head(own, common)
        rotation = on_head @ _lean_back(common)
        angles = angles_of(rotation)
        common = _spread(common, own)
        F, D = own.shape
        zoom = own[:, :1] - self.log_focal
        lever = self._lever(zoom, common)
        axes = np.zeros((F, 3, D + len(COMMON)))
        axes[:, :, 1], axes[:, :, 2] = on_head[:, :, 2], _tilt_axis(common[:, _ROLL])
        axes[:, 2, D + _ROLL] = 1.0
        axes[:, :, D + _LEAN.start], axes[:, :, D + _LEAN.start + 1] = rotation[:, :, 0], on_head[:, :, 1]
        turn = np.zeros((F, 3, 3))
        turn[:, :, 0], turn[:, :, 1], turn[:, 2, 2] = rotation[:, :, 2], _tilt_axis(angles[:, 2]), 1.0
        by = np.zeros((F, len(PARAMETERS), D + len(COMMON)))
        by[:, ANGLES] = np.linalg.solve(turn, axes)
        # d(R^T e) = R^T (w x e) along the optical axis e = (0, 0, 1)
        beside = np.zeros_like(axes)
        beside[:, 0], beside[:, 1] = axes[:, 1], -axes[:, 0]
        by[:, POSITION] = lever[..., None] * (rotation.swapaxes(1, 2) @ beside)
        by[:, POSITION, 0] += common[:, _LEVER.stop - 1, None] * rotation[:, 2]
        by[:, POSITION, D : D + 3] += np.eye(3)
        by[:, POSITION, D + _LEVER.start] += rotation[:, 2]
        by[:, POSITION, D + _LEVER.start + 1] += zoom * rotation[:, 2]
        by[:, LOG_FOCAL, 0] = 1.0
        by[:, _TO, D + _FROM] = 1.0
        by[:, _ZOOM_TO, D + _ZOOM_FROM] = zoom
        by[:, _ZOOM_TO, 0] = common[:, _ZOOM_FROM]
        bend, steeper = self._bend(own)
        by[:, KAPPA_1, 0] += common[:, _BY_FOCAL] * steeper
        by[:, KAPPA_1, D + _BY_FOCAL] = bend
        if D > 3:
            by[:, _BLOOM, 3] = 1.0
        return self._thetas(own, common, rotation, angles), by[..., :D], by[..., D:]

    def linearise_one(self, own: Array, common: Array) -> tuple[Array, Array, Array]:
        """:meth:`linearise` for one camera, own (O,): (P,), (P, O) and (P, K)."""
        theta, by_own, by_common = self.linearise(own[None], common)
        return theta[0], by_own[0], by_common[0]

    def derivatives(self, own: Array, common: Array) -> tuple[Array, Array]:
        """Derivatives of :meth:`thetas` by the own (F, P, O) and by the common parameters (F, P, K)."""
        return self.linearise(own, common)[1:]

    def project_world(self, own: Array, common: Array, world: Array) -> Array:
        """Pixels (F, N, 2) of points (N, 3) of the world that need not lie on the field, before any camera or not."""
        rotation = self.rotations(own, common)
        common = _spread(common, own)
        zoom = own[:, :1] - self.log_focal
        position = common[:, _AXIS] + self._lever(zoom, common) * rotation[:, 2]
        local = (world - position[:, None]) @ rotation.swapaxes(1, 2)
        normalised = local[..., :2] / np.maximum(local[..., 2:], 1e-3)
        lens_of = {name: common[:, PLACE[name], None] for name in _LENS}
        focal = np.exp(own[:, :1])
        r2 = (normalised**2).sum(axis=-1) * (2.0 / self.projection.width * focal) ** 2
        first = lens_of["kappa_1"] + zoom * lens_of["kappa_1_by_zoom"]
        first = first + common[:, _BY_FOCAL, None] * self._bend(own)[0][:, None]
        factor, _ = lens_factor(r2, first, lens_of["kappa_2"])
        pixels = normalised * (focal * factor)[..., None]
        pixels[..., 1] *= np.exp(lens_of["log_aspect"])
        beside = [lens_of[name] + zoom * lens_of[f"{name}_by_zoom"] for name in ("pp_x", "pp_y")]
        return np.asarray(pixels + self.projection.center + np.concatenate(beside, axis=1)[:, None])

    def rotations(self, own: Array, common: Array) -> Array:
        """Rotations (F, 3, 3) from the field's axes to the cameras'."""
        return np.asarray(self._head(own, common) @ _lean_back(common))

    def shift_of_axis(self, own: Array, common: Array) -> Array:
        """How far (2,) from its middle the second of two pictures, own (2, O), shows what lies on the optical axis of
        the first, pixels; without what lever and lens make of it.
        """
        before, after = self.rotations(own, common)
        seen = after @ before[2]
        focal = np.exp(own[1, 0] + np.array([0.0, common[PLACE["log_aspect"]]]))
        return np.asarray(focal * seen[:2] / max(seen[2], _LEAST_AHEAD))

    def rays_about(self, own: Array, common: Array, pixels: Array) -> tuple[Array, Array]:
        """Position (3,) of one camera, own (O,), and directions (N, 3) of unit depth in which it sees pixels (N, 2).

        The lens is taken back in two steps, which leaves up to a few pixels at the border of the picture;
        :meth:`circlecal.geometry.camera.Camera.rays` is exact.
        """
        theta = self.thetas(own[None], common)
        focal = np.exp(theta[0, LOG_FOCAL])
        seen = (pixels - self.projection.center - theta[0, PRINCIPAL]) / focal
        seen[:, 1] *= np.exp(-theta[0, LOG_ASPECT])
        r2 = (seen * seen).sum(axis=1) * (2.0 / self.projection.width * focal) ** 2
        lens, _ = lens_factor(r2, *theta[0, KAPPA])
        lens, _ = lens_factor(r2 / lens**2, *theta[0, KAPPA])
        rays = np.column_stack([seen / lens[:, None], np.ones(len(seen))])
        return theta[0, POSITION], rays @ self.rotations(own[None], common)[0]

    def own_of(self, theta: Array, common: Array) -> Array:
        """Own parameters (F, 4) of cameras (F, P): the head's angles that turn the tripod's camera the same way."""
        angles, _ = self.head_of(theta, common)
        return np.column_stack([theta[:, LOG_FOCAL], angles[:, :2], theta[:, _BLOOM]])

    def head_of(self, theta: Array, common: Array) -> tuple[Array, Array]:
        """Pan, tilt and roll (F, 3) on the head of cameras (F, P), and where its axes meet (F, 3); the pans are those
        of :func:`unwrap_pan`.
        """
        rotation = rotations_by(theta[:, ANGLES])
        lever = self._lever(theta[:, :1] - self.log_focal, common[None])
        angles = angles_of(rotation @ _lean_back(common).swapaxes(-1, -2))
        angles[:, 0] = unwrap_pan(angles[:, 0], common[_AXIS])
        return angles, theta[:, POSITION] - lever * rotation[:, 2]

    def _thetas(self, own: Array, common: Array, rotation: Array, angles: Array) -> Array:
        zoom = own[:, :1] - self.log_focal
        theta = np.zeros((len(own), len(PARAMETERS)))
        theta[:, LOG_FOCAL] = own[:, 0]
        theta[:, ANGLES] = angles
        theta[:, POSITION] = common[:, _AXIS] + self._lever(zoom, common) * rotation[:, 2]
        theta[:, _TO] = common[:, _FROM]
        theta[:, _ZOOM_TO] += zoom * common[:, _ZOOM_FROM]
        theta[:, KAPPA_1] += common[:, _BY_FOCAL] * self._bend(own)[0]
        if own.shape[1] > 3:
            theta[:, _BLOOM] = own[:, 3]
        return theta

    def _head(self, own: Array, common: Array) -> Array:
        """Rotations (F, 3, 3) from the head's axes to the cameras."""
        angles = np.empty((len(own), 3))
        angles[:, :2], angles[:, 2] = own[:, 1:3], common[..., _ROLL]
        return rotations_by(angles)

    def _bend(self, own: Array) -> tuple[Array, Array]:
        """What a bend of 1 adds to the first radial coefficient (F,), and its derivative by the zoom (F,)."""
        return ZoomLens(0.0, 1.0, self.projection.width).bend(own[:, 0], self.log_focal)

    @staticmethod
    def _lever(zoom: Array, common: Array) -> Array:
        return np.asarray(common[:, _LEVER.start, None] + zoom * common[:, _LEVER.start + 1, None])


@dataclass(frozen=True, slots=True)
class PaintersShare:
    """What is open of a tripod's parameters by painters' errors, which all its frames have in common, and by all else.

    Attributes
    ----------
    covariance : (K, K) array
        Of the parameters if painters made no errors.
    by_errors : mapping of str to (K,) array
        How the parameters follow each error of one standard deviation, by its name.
    """

    covariance: Array
    by_errors: Mapping[str, Array]

    @property
    def whole(self) -> Array:
        """Covariance (K, K) of the parameters with painters' errors."""
        follows = np.stack([np.zeros(len(COMMON)), *self.by_errors.values()], axis=1)
        return np.asarray(self.covariance + follows @ follows.T)

    def resize(self, unit: Array) -> PaintersShare:
        """The share where each parameter (K,) is so many times as large."""
        by_errors = {name: values * unit for name, values in self.by_errors.items()}
        return PaintersShare(self.covariance * np.outer(unit, unit), by_errors)


@dataclass(frozen=True, slots=True)
class TripodEstimate:
    """A camera on its tripod as frames have determined it, with its pitch.

    Attributes
    ----------
    name : str
        Of the camera, such as ``camera-1``.
    size : (int, int)
        Width and height of the pictures that pixels refer to.
    log_focal : float
        Logarithm of the focal length in pixels at which lever, principal point and lens are quoted.
    surface : Surface
        Profile of the pitch with the estimated crown.
    mean, covariance : (K,), (K, K) arrays
        Of the parameters :data:`COMMON`; a variance of 0 says that one is fixed.
    head_low, head_high : (3,) arrays
        Least and greatest logarithm of the focal length, pan and tilt among the frames: where it is known.
    used, left_out : tuples of str
        Frames that determined it, and frames of a false calibration.
    painters : PaintersShare, optional
        What is open of the parameters where painters' errors are told apart; None where painters make none, or they are
        not told apart.
    """

    name: str
    size: tuple[int, int]
    log_focal: float
    surface: Surface
    mean: Array
    covariance: Array
    head_low: Array
    head_high: Array
    used: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    painters: PaintersShare | None = None

    @property
    def whole_covariance(self) -> Array:
        """Covariance (K, K) of the parameters with what painters' errors leave open of them, where these are known."""
        return self.covariance if self.painters is None else self.painters.whole

    @property
    def model(self) -> TripodModel:
        """The map from its parameters to cameras."""
        width, height = self.size
        return TripodModel(ProjectionModel(width, height, replace(self.surface, crown_m=1.0)), self.log_focal)

    @property
    def growth_m(self) -> Array:
        """By how much the pitch is longer and broader than the template's (2,), metres."""
        return self.mean[[PLACE["length"], PLACE["breadth"]]]

    def sigma(self, name: str) -> float:
        """Standard deviation of a parameter."""
        return float(np.sqrt(self.covariance[PLACE[name], PLACE[name]]))

    def resize(self, size: tuple[int, int], stretch: float = 1.0) -> TripodEstimate:
        """The camera for pictures of another size, in which it shows the same; with ``stretch`` those of which the
        rows grow so many times as much as the columns.
        """
        factor = size[0] / self.size[0]
        unit = np.array([factor if name in _PIXELS else 1.0 for name in COMMON])
        unit[[PLACE[name] for name in _ROWS]] *= stretch
        shift = np.array([np.log(factor), 0.0, 0.0])
        mean = self.mean * unit
        mean[PLACE["log_aspect"]] += np.log(stretch)
        return replace(
            self,
            size=size,
            log_focal=self.log_focal + float(np.log(factor)),
            mean=mean,
            covariance=self.covariance * np.outer(unit, unit),
            head_low=self.head_low + shift,
            head_high=self.head_high + shift,
            painters=None if self.painters is None else self.painters.resize(unit),
        )

    def suit_pixels(self, size: tuple[int, int], aspect: float) -> TripodEstimate:
        """The camera for pictures whose pixels are ``aspect`` times as wide as tall, where its own are known to be of
        another shape; itself where they are of that shape, or where theirs was estimated.
        """
        stretch = aspect / float(np.exp(self.mean[PLACE["log_aspect"]]))
        if abs(stretch - 1.0) < SAME_SHAPE or self.sigma("log_aspect") > 0.0:
            return self
        return self.resize(size, stretch)

    def suit_pictures(self, size: tuple[int, int], aspect: float) -> TripodEstimate:
        """The camera for pictures of another size whose pixels are ``aspect`` times as wide as tall.

        Raises
        ------
        InputError
            They show another shape than the camera's: what it shows in them is not known.
        """
        suited = self.suit_pixels(size, aspect)
        framings = ((self, self.size), (suited, size))
        own, other = (np.exp(t.mean[PLACE["log_aspect"]]) * width / height for t, (width, height) in framings)
        if abs(own / other - 1.0) > SAME_FRAMING:
            raise InputError(
                f"{self.name}: picture_px {list(self.size)} of the venue is {own:.2f} times as wide as tall, and "
                f"pictures of {size[0]} x {size[1]} pixels {other:.2f} times; give a venue of such pictures"
            )
        return suited if suited.size == size else suited.resize(size)

    def view(
        self, own: Array, own_covariance: Array, cross: Array | None = None, by_errors: Array | None = None
    ) -> FieldView:
        """What a frame sees.

        Parameters
        ----------
        own : (3,) array
            Logarithm of the focal length, pan and tilt on the head.
        own_covariance : (3, 3) array
            Their covariance where the tripod is known exactly.
        cross : (3, K) array, optional
            How they follow the common parameters; 0 without.
        by_errors : (3 + K, E) array, optional
            How they follow painters' errors of one standard deviation where the common parameters are known, and how
            these follow them; nothing follows them without.
        """
        model = self.model
        theta, by_own, by_common = model.linearise_one(own, self.mean)
        if cross is not None:
            by_common = by_common + by_own @ cross
        covariance = self._spread(by_own, by_common, own_covariance, by_errors)
        surface = replace(self.surface, crown_m=float(theta[CROWN]))
        return FieldView(camera_of(theta, model.projection), surface, self.growth_m.copy(), covariance)

    def widen_head(self, own_covariance: Array, cross: Array, by_errors: Array | None = None) -> Array:
        """Covariance (3, 3) of a frame's own parameters with what the tripod leaves open; parameters as for
        :meth:`view`.
        """
        return self._spread(np.eye(3), cross, own_covariance, by_errors)

    def _spread(self, by_own: Array, by_common: Array, own_covariance: Array, by_errors: Array | None) -> Array:
        """Covariance (P, P) of what follows a frame's own parameters (P, 3) and the common ones (P, K)."""
        shared = self.covariance if by_errors is None or self.painters is None else self.painters.covariance
        covariance = by_own @ own_covariance @ by_own.T + by_common @ shared @ by_common.T
        if by_errors is not None:
            moved = np.concatenate([by_own, by_common], axis=1) @ by_errors
            covariance = covariance + moved @ moved.T
        return np.asarray(covariance)


@dataclass(frozen=True, slots=True)
class Venue:
    """What a run knows of its place.

    Attributes
    ----------
    field : str
        Name of the field template.
    tripods : tuple of TripodEstimate
        The cameras that stand there.
    paint_bgr : (float, float, float) or None
        What the paint adds to blue, green and red of its surface, where this tells it better than its brightness.
    """

    field: str
    tripods: tuple[TripodEstimate, ...] = ()
    paint_bgr: tuple[float, float, float] | None = None

    def tripod(self, name: str) -> TripodEstimate:
        """The camera of that name.

        Raises
        ------
        KeyError
            There is none.
        """
        return {tripod.name: tripod for tripod in self.tripods}[name]

    def suit_pictures(self, size: tuple[int, int], aspect: float) -> Venue:
        """The venue for pictures of another size and shape of pixels; see :meth:`TripodEstimate.suit_pictures`."""
        return replace(self, tripods=tuple(tripod.suit_pictures(size, aspect) for tripod in self.tripods))


def angles_of(rotation: Array) -> Array:
    """Pan, tilt and roll (F, 3) of world-to-camera rotations (F, 3, 3) of cameras that do not look straight down."""
    o = np.swapaxes(rotation, 1, 2)
    pan = np.arctan2(o[:, 0, 2], -o[:, 1, 2])
    cp, sp = np.cos(pan), np.sin(pan)
    tilt = np.arctan2(np.hypot(o[:, 0, 2], o[:, 1, 2]), o[:, 2, 2])
    roll = np.arctan2(-(cp * o[:, 0, 1] + sp * o[:, 1, 1]), cp * o[:, 0, 0] + sp * o[:, 1, 0])
    return np.stack([pan, tilt, roll], axis=-1)


def unwrap_pan(pan: Array, axis_m: Array) -> Array:
    """Pans, radians, less than half a turn from the direction from a pan axis (2 or more,), metres, to the middle of
    the field: those of a camera on its far side do not jump from pi to -pi where it looks straight across.
    """
    to_middle = np.arctan2(-axis_m[0], axis_m[1])
    to_middle += 2.0 * np.pi * (to_middle < LEAST_TO_MIDDLE_RAD)
    return np.asarray(pan + 2.0 * np.pi * np.round((to_middle - pan) / (2.0 * np.pi)))


def _tilt_axis(roll: Array) -> Array:
    """Axis (F, 3) of the tilt in camera coordinates."""
    axis = np.zeros((len(roll), 3))
    axis[:, 0], axis[:, 1] = np.cos(roll), -np.sin(roll)
    return axis


def _spread(common: Array, own: Array) -> Array:
    """Common parameters (F, K) of every frame, from (K,) or (F, K)."""
    return np.broadcast_to(common, (len(own), len(COMMON)))


def _lean_back(common: Array) -> Array:
    """Rotations (..., 3, 3) from the field's axes to the head's, of common parameters (..., K)."""
    x, y = common[..., _LEAN.start], common[..., _LEAN.start + 1]
    cx, cy, sx, sy = np.cos(x), np.cos(y), np.sin(x), np.sin(y)
    found = np.zeros((*common.shape[:-1], 3, 3))
    found[..., 0, 0], found[..., 2, 0] = cy, sy
    found[..., 0, 1], found[..., 1, 1], found[..., 2, 1] = sx * sy, cx, -sx * cy
    found[..., 0, 2], found[..., 1, 2], found[..., 2, 2] = -cx * sy, sx, cx * cy
    return found
