"""What a calibration is to the one who asked for it: a verdict, and both ways between picture and field."""

from __future__ import annotations

import contextlib
import os
import weakref
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from circlecal import overlay
from circlecal.api.notebook import show_record
from circlecal.api.transformer import ViewTransformer, as_points
from circlecal.errors import ConfigError, InputError
from circlecal.field import FieldTemplate, field_names, load_field
from circlecal.field.view import FieldView
from circlecal.files import exists, is_folder, read_file, remove_file
from circlecal.formats.exports import Exports, field_of_record, require_field
from circlecal.formats.format import MAX_BYTES, AnnotationFormat, CameraFormat
from circlecal.formats.registry import calibration_formats, require_format
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array, PointsLike
from circlecal.names import as_stem, picture_name, show
from circlecal.pictures.files import as_bgr, read_image
from circlecal.pictures.video import pictures_at
from circlecal.records.json_text import to_mapping, write_result
from circlecal.records.parts import Matrix
from circlecal.records.record import ResultRecord
from circlecal.records.stored import calibration_of_record
from circlecal.refusals import explain
from circlecal.results import Attempt, Check, Status

if TYPE_CHECKING:
    from circlecal import results

Picture = NDArray[np.uint8]


class SurePoints(NamedTuple):
    """Points with how sure they are, as :meth:`Calibration.to_field` and :meth:`Calibration.to_image` give them with
    ``sigma=True``.

    Attributes
    ----------
    points : (..., 2) array
        Pixels or metres; nan where a point is nowhere.
    sigma : (...,) array
        Standard deviation of the length of the error of each, in the unit of the points; nan where it is not known.
    """

    points: Array
    sigma: Array


class Calibration:
    """One calibrated or refused frame.

    It comes from :func:`circlecal.calibrate` and its siblings, or from :func:`circlecal.load`. Its content is that of a
    result file: two are equal where their contents are, and it pickles without pictures. A refused frame answers every
    question too: its values are None and its points nan.

    Pixels are those of the picture as stored, ``(0, 0)`` at the centre of the top-left one. Field points are metres
    from the centre mark, x to the right along the length and y towards the main camera.
    """

    def __init__(
        self,
        record: ResultRecord,
        template: FieldTemplate | None = None,
        *,
        found: results.FrameCalibration | None = None,
        image: NDArray[Any] | None = None,
    ) -> None:
        """Wrap the content of a result file.

        Parameters
        ----------
        record : ResultRecord
            The content.
        template : FieldTemplate, optional
            The field, where it is none of those that come with circlecal.
        found : circlecal.results.FrameCalibration, optional
            Every intermediate; what the record says of them when None.
        image : array, optional
            The picture as for :func:`circlecal.calibrate`, which is remembered as long as somebody else holds it.
        """
        self._record = record
        self._given_template = template
        self._found = found
        self._image = None if image is None else weakref.ref(image)

    # --- which frame, and whether it was calibrated

    @property
    def id(self) -> str:
        """Name of the frame."""
        return self._record.id

    @property
    def source(self) -> str | None:
        """File or address of the picture, as it was given; None for an array."""
        return self._record.path

    @property
    def time_s(self) -> float | None:
        """Time of the frame in its video, seconds."""
        return None if self._record.source is None else self._record.source.time_s

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height of the picture, pixels; None where it could not be read."""
        image = self._record.image
        return None if image is None else (image.width, image.height)

    @property
    def status(self) -> Status:
        """``"calibrated"`` or ``"refused"``."""
        return self._record.status

    @property
    def ok(self) -> bool:
        """Whether the frame was calibrated."""
        return self.status == "calibrated"

    @property
    def code(self) -> str | None:
        """Why it was refused, for programs, such as ``"too_uncertain"``; None where it was not."""
        return self._record.code

    @property
    def reason(self) -> str | None:
        """Why it was refused, for people."""
        return self._record.reason

    @property
    def near_limits(self) -> list[str]:
        """Checks on which the verdict hangs, which only just passed or failed, as ``sigma_px 5.62 of 6``."""
        return self._record.near_limits

    @property
    def help(self) -> str | None:
        """What helps against the refusal."""
        return None if self.code is None else explain(self.code, self._record.stage).help

    @property
    def checks(self) -> tuple[Check, ...]:
        """The checks of the verdict with their values and limits."""
        return self.found.verdict.checks

    # --- between picture and field

    @overload
    def to_image(self, points_m: PointsLike, *, sigma: Literal[False] = False) -> Array: ...

    @overload
    def to_image(self, points_m: PointsLike, *, sigma: Literal[True]) -> SurePoints: ...

    def to_image(self, points_m: PointsLike, *, sigma: bool = False) -> Array | SurePoints:
        """Where points of the field are seen, through lens and surface.

        Parameters
        ----------
        points_m : (..., 2) or (..., 3) array
            Field points, metres; or points in space with z, which points down from the level of the centre mark: the
            middle of a crossbar is at ``(52.5, 0, -2.44)``.
        sigma : bool
            Whether to return their standard deviations too.

        Returns
        -------
        (..., 2) array, or SurePoints with ``points`` (..., 2) and ``sigma`` (...,)
            Pixels, also of what lies outside the picture; nan behind the camera, where the lens model folds back, and
            for a refused frame. The standard deviation is that of the length of the error, pixels; nan where it is not
            known, as for points in space.

        Raises
        ------
        ValueError
            The last axis does not hold two or three numbers.
        """
        return self._answer(points_m, None if self.view is None else self.view.project, sigma, (2, 3))

    def image_covariance(self, points_m: PointsLike) -> Array:
        """Covariances (..., 2, 2), pixels squared, of where field points (..., 2) are seen; nan where not known.

        ``to_image(points_m, sigma=True).sigma`` is the root of their traces. Points of another shape are a ValueError.
        """
        points = _points(points_m)
        return np.full((*points.shape, 2), np.nan) if self.view is None else self.view.image_covariance(points)

    def field_covariance(self, points_px: PointsLike, *, point_sigma_px: PointsLike = 0.0) -> Array:
        """Covariances (..., 2, 2), square metres, of the field points seen at pixels (..., 2); nan where not known.

        ``to_field(points_px, sigma=True, point_sigma_px=...).sigma`` is the root of their traces, and raises alike.
        """
        points = _points(points_px)
        own = _point_sigma(point_sigma_px, points)
        return np.full((*points.shape, 2), np.nan) if self.view is None else self.view.field_covariance(points, own)

    @overload
    def to_field(self, points_px: PointsLike, *, sigma: Literal[False] = False) -> Array: ...

    @overload
    def to_field(
        self, points_px: PointsLike, *, sigma: Literal[True], point_sigma_px: PointsLike = 0.0
    ) -> SurePoints: ...

    def to_field(
        self, points_px: PointsLike, *, sigma: bool = False, point_sigma_px: PointsLike = 0.0
    ) -> Array | SurePoints:
        """What points of the field are seen at pixels, such as where the feet of players are.

        Parameters
        ----------
        points_px : (..., 2) array
            Pixels of the picture; those that a masked array hides are nowhere, nan.
        sigma : bool
            Whether to return their standard deviations too: what the camera leaves open of the place that these pixels
            show.
        point_sigma_px : float or (...,) array
            How well the pixels themselves are known, such as the feet that somebody clicked or a detector found: one
            standard deviation along x and along y, which the standard deviations then hold too. From main cameras 2 px
            are about a decimetre in the middle of the pitch and several at its far touchline.

        Returns
        -------
        (..., 2) array, or SurePoints with ``points`` (..., 2) and ``sigma`` (...,)
            Metres; nan on and above the horizon, where the ray meets no surface, and for a refused frame. The standard
            deviation is that of the length of the error, metres; nan where it is not known.

        Raises
        ------
        ValueError
            The last axis does not hold two numbers; or a pixel is known to a standard deviation that is negative, not
            finite or of another shape than the pixels.
        """
        own = _point_sigma(point_sigma_px, _points(points_px))
        view = self.view
        return self._answer(points_px, None if view is None else partial(view.to_field, point_sigma_px=own), sigma)

    @staticmethod
    def _answer(points: PointsLike, convert: Any, sigma: bool, entries: tuple[int, ...] = (2,)) -> Array | SurePoints:
        given = _points(points, entries)
        if convert is None:
            nowhere = np.full((*given.shape[:-1], 2), np.nan)
            return SurePoints(nowhere, nowhere[..., 0]) if sigma else nowhere
        if not sigma:
            return convert(given)
        found, spread = convert(given, sigma=True)
        return SurePoints(found, np.full(given.shape[:-1], np.nan) if spread is None else spread)

    def transformer(self, size: tuple[float, float] | None = None) -> ViewTransformer:
        """Pixels to the field for tracking tools that call ``transform_points``.

        Parameters
        ----------
        size : (float, float), optional
            Length and width of the map that they draw on, its origin in the top-left corner, in the units of the map;
            metres from the centre mark when None.

        Raises
        ------
        ValueError
            The map has no length or no width.
        ConfigError
            As for :attr:`field`, where a size is given.
        """
        return ViewTransformer(self.view, None if size is None else self.field, size)

    @property
    def view(self) -> FieldView | None:
        """The field before the camera, with surface and covariance; None for a refused frame."""
        return self.found.view if self.ok else None

    @property
    def H_image_field(self) -> Array | None:
        """Homography (3, 3) from field points in metres to undistorted pixels (those of ``cv2.undistort``).

        The field is the plane level with the centre mark: a crowned pitch falls from it, so that :meth:`to_image` and
        :meth:`to_field`, which know how far, differ from it towards the touchlines.
        """
        return _array(self._record.H_image_field)

    @property
    def H_field_image(self) -> Array | None:
        """Homography (3, 3) from undistorted pixels to field points on the plane of :attr:`H_image_field`, metres."""
        return _array(self._record.H_field_image)

    # --- the camera

    @property
    def camera(self) -> Camera | None:
        """The camera with its lens.

        None for a refused frame, and where only a homography was asked for: with ``camera.enabled=False``, or with the
        ``solver`` of a published method. Such a frame is ``ok`` and has :attr:`H_image_field`, while :attr:`K`,
        :attr:`R`, :attr:`t`, :attr:`dist`, :attr:`position_m`, :attr:`sigma_px` and :attr:`sigma_m` are None.
        """
        fit = self.found.attempt.camera if self.ok else None
        return None if fit is None else fit.camera

    def require_camera(self) -> Camera:
        """The camera, of which ``K``, ``R``, ``t``, ``dist`` and ``position_m`` are never None.

        Raises
        ------
        InputError
            There is none, and why: the frame was refused, or only a homography was asked for.
        """
        if self.camera is None:
            why = "only a homography was asked for" if self.ok else f"it was refused: {self.reason}"
            raise InputError(f"{self.id}: has no camera, since {why}")
        return self.camera

    @property
    def K(self) -> Array | None:
        """Calibration matrix (3, 3), pixels, as ``cv2.projectPoints`` and ``cv2.undistort`` take it; None where there
        is no :attr:`camera`.
        """
        return None if self.camera is None else self.camera.K

    @property
    def R(self) -> Array | None:
        """Rotation (3, 3) from field to camera; ``cv2.Rodrigues`` makes the vector of it that OpenCV takes. None where
        there is no :attr:`camera`.
        """
        return None if self.camera is None else self.camera.R

    @property
    def t(self) -> Array | None:
        """Translation (3,) from field to camera, metres, as OpenCV takes it; None where there is no :attr:`camera`."""
        return None if self.camera is None else self.camera.t

    @property
    def dist(self) -> Array | None:
        """Distortion coefficients (4,), as OpenCV takes them: k1, k2, 0, 0. None where there is no :attr:`camera`."""
        return None if self.camera is None else self.camera.dist

    @property
    def position_m(self) -> Array | None:
        """Where the camera stands (3,), metres; z points down, so it is negative above the ground. None where there is
        no :attr:`camera`.
        """
        return None if self.camera is None else self.camera.position_m

    @property
    def sigma_px(self) -> float | None:
        """Largest predicted standard deviation of the field in view within 2.5 radii of the circle, or of what is seen
        instead, pixels; None where there is no :attr:`camera`.
        """
        return None if self._record.camera is None else self._record.camera.max_sigma_px

    @property
    def sigma_m(self) -> float | None:
        """Largest predicted standard deviation on the field in view near the circle, metres; None where there is no
        :attr:`camera`.
        """
        return None if self._record.camera is None else self._record.camera.max_sigma_m

    @property
    def region(self) -> results.HomographyRegion | None:
        """Where the true homography lies; None where no camera was estimated, or hardly any of the field is in view.

        ``region.distance(H)`` of the truth is distributed as chi-square with ``region.directions`` degrees of freedom:
        below ``scipy.stats.chi2.ppf(0.9, region.directions)`` in 90 of 100 frames. That holds while the camera is known
        well: where :attr:`sigma_px` is beyond some 40 px (at 1920 px width) zoom and distance make up for each other
        along a valley that no ellipsoid follows, and fewer truths lie in it.
        """
        fit = self.found.attempt.camera if self.ok else None
        return None if fit is None else fit.region

    # --- what it was made of

    @cached_property
    def field(self) -> FieldTemplate:
        """The field template with all its markings.

        Raises
        ------
        ConfigError
            A template of the user's own that was not given to :func:`circlecal.load`.
        """
        if self._given_template is not None:
            return self._given_template
        known = self._record.field
        if known is None:
            return load_field("soccer")
        if known.template not in field_names():
            raise ConfigError(
                f"the result is of the field {known.template!r}, a template of your own; give its file: "
                'circlecal.load(result, field="your.yaml")'
            )
        return load_field(known.template, known.sizes)

    @cached_property
    def found(self) -> results.FrameCalibration:
        """Every intermediate, for those who know the stages; of a result file what it holds of them."""
        return calibration_of_record(self._record) if self._found is None else self._found

    @property
    def attempt(self) -> Attempt:
        """What each stage reached; None where it was not.

        ``attempt.ellipses.primary.conic`` is the image of the circle, ``attempt.correspondences`` the paper's eight
        ``points`` and ``tangents`` with its ``case``, ``imaged_center`` and ``vanishing_line``, ``attempt.homography``
        the DLT of these and of what was seen beside the circle, ``attempt.camera`` the camera with its covariance.

        See :class:`circlecal.results.Attempt`.
        """
        return self.found.attempt

    @property
    def image(self) -> Picture | None:
        """The picture (H, W, 3), BGR of 8 bit: what was given while somebody holds it, or read from its file again.

        An array whose content changes afterwards, as that of a camera that writes each frame into one buffer, shows its
        new content.
        """
        held = None if self._image is None else self._image()
        if held is not None or self.source is None:
            return None if held is None else as_bgr(held, "image")
        try:
            if self.time_s is not None:
                return next(pictures_at(Path(self.source), [self.time_s]))
            return read_image(self.source)
        except InputError:
            return None

    # --- pictures, files

    def overlay(self, image: NDArray[Any] | str | Path | None = None) -> Picture:
        """Draw the field template and the verdict over the picture.

        Parameters
        ----------
        image : array or path, optional
            The picture, as :func:`circlecal.calibrate` takes it; the frame's own when None.

        Returns
        -------
        (H, W, 3) uint8
            BGR.

        Raises
        ------
        InputError
            There is no picture, one that cannot be read, or one of another size.
        TypeError
            The picture is neither an array nor a path.
        ConfigError
            As for :attr:`field`.
        """
        return overlay.draw_overlay(self._picture(image), self.found, self.field)

    def top_view(self, image: NDArray[Any] | str | Path | None = None, px_per_m: float = 10.0) -> Picture | None:
        """The picture as it would be seen from straight above, with the template drawn over it.

        Parameters
        ----------
        image : array or path, optional
            The picture, as :func:`circlecal.calibrate` takes it; the frame's own when None.
        px_per_m : float
            Resolution.

        Returns
        -------
        uint8 array (H, W, 3) or None
            BGR; None for a refused frame.

        Raises
        ------
        InputError
            There is no picture, one that cannot be read, or one of another size.
        TypeError
            The picture is neither an array nor a path.
        ConfigError
            As for :attr:`field`.
        """
        return overlay.draw_radar(self._picture(image), self.found, self.field, px_per_m) if self.ok else None

    def _picture(self, image: NDArray[Any] | str | Path | None) -> Picture:
        if image is None:
            picture = self.image
        elif isinstance(image, np.ndarray):
            picture = as_bgr(image, "image")
        elif isinstance(image, str | os.PathLike):
            picture = read_image(os.fspath(image))
        else:
            raise TypeError(f"image must be an array or a path, not {type(image).__name__}")
        if picture is None:
            raise InputError(f"{self.id}: its picture is not at hand; give it: overlay(image), top_view(image)")
        if picture.shape[1::-1] != self.size:
            width, height = picture.shape[1::-1]
            raise InputError(f"{self.id}: the picture is {width} x {height}, the calibration is of {self._size_text}")
        return picture

    def to_dict(self) -> dict[str, Any]:
        """Content of the result file, ready for ``json.dumps``; every key is explained in ``circlecal/formats``."""
        return to_mapping(self._record)

    def save(self, path: str | Path) -> Path:
        """Write the result file, which :func:`circlecal.load` reads.

        Parameters
        ----------
        path : path
            The file, whose name ends in ``.json``, or a folder, in which it is called ``<id>.json``.

        Returns
        -------
        path
            The file.

        Raises
        ------
        InputError
            The file cannot be written, or it exists and is no result of circlecal: a picture or an annotation is never
            written over.
        """
        file = Path(path)
        if _is_meant_as_folder(path):
            file = file / f"{as_stem(self.id)}.json"
        write_result(file, self._record)
        return file

    def export(self, format: str, folder: str | Path, size: tuple[int, int] | None = None) -> list[Path]:
        """Write the calibration for another program, as ``circlecal calibrate --to`` does.

        Several frames go into a format of one file for all frames, such as ``"coco"``, by :func:`circlecal.export`.

        Parameters
        ----------
        format : str
            Such as ``"soccernet"``, ``"tvcalib"`` or ``"coco"``; all are explained in ``circlecal/formats``.
        folder : path
            Where; made where it is missing.
        size : (int, int), optional
            Width and height of the pictures in which the written camera counts; the frame's own when None.

        Returns
        -------
        list of path
            The files; none of a refused frame in a format of cameras, where what an earlier call wrote of it is gone.

        Raises
        ------
        InputError
            An unknown format or one that cannot say this field, a file for all frames that holds another one, or a file
            that cannot be written.
        ConfigError
            As for :attr:`field`.
        """
        require_format(format, calibration_formats(), "format", "format that can be written")
        require_field([format], self.field)
        exports, form = Exports([format], Path(folder), size), calibration_formats()[format]
        if not form.per_frame:
            file = Path(folder) / form.file_name
            _require_own(file, form, {self.id, Path(self._picture_name or self.id).stem}, self.size)
            if isinstance(form, CameraFormat) and not self.ok:
                remove_file(file)
                return []
        self.add_to(exports)
        exports.finish()
        return exports.written

    def add_to(self, exports: Exports) -> None:
        """Take this frame into what is written of several for other programs, as :func:`circlecal.export` does.

        Raises
        ------
        InputError
            A file cannot be written.
        ConfigError
            As for :attr:`field`.
        """
        own = self.field
        exports.add(self._record, *field_of_record(self._record, own, lambda _: own), self._picture_name)

    @property
    def _picture_name(self) -> str | None:
        return picture_name(self.id, self.source, self.time_s)

    # --- as a value

    @cached_property
    def _content(self) -> dict[str, Any]:
        """What counts: everything but how long it took and which version of the program it was."""
        return {key: value for key, value in self.to_dict().items() if key not in ("timings_ms", "version")}

    def __eq__(self, other: object) -> bool:
        return self._content == other._content if isinstance(other, Calibration) else NotImplemented

    def __hash__(self) -> int:
        return hash((self.id, self.source, self.code, str(self._record.H_image_field)))

    def __reduce__(self) -> tuple[Any, ...]:
        return Calibration, (self._record, self._given_template)

    @property
    def _size_text(self) -> str:
        return "an unknown size" if self.size is None else f"{self.size[0]} x {self.size[1]}"

    def __repr__(self) -> str:
        if not self.ok:
            return f"Calibration({self.id!r}, refused: {self.code})"
        where = "" if self.position_m is None else " at ({:z.1f}, {:z.1f}, {:.1f}) m".format(*self.position_m)
        spread = "" if self.sigma_px is None else f", sigma {self.sigma_px:.1f} px"
        return f"Calibration({self.id!r}, calibrated{where}{spread})"

    def _repr_html_(self) -> str:
        """The overlay picture, where the picture is at hand, and a table."""
        image = self.image
        drawn = None
        if image is not None and image.shape[1::-1] == self.size:
            with contextlib.suppress(ConfigError):  # of a field of somebody's own, whose file was not given
                drawn = self.overlay(image)
        return show_record(self._record, drawn)


def _require_own(
    file: Path, form: AnnotationFormat | CameraFormat, own: set[str], size: tuple[int, int] | None
) -> None:
    """See that a file for all frames is missing, or holds no frame but one that has the names ``own``.

    Raises
    ------
    InputError
        It holds others, or something else.
    """
    if not exists(file):
        return
    try:
        held = {frame.id for frame in form.read(file, read_file(file, MAX_BYTES, "choose another folder"), size)}
    except InputError as error:
        raise InputError(f"{file}: is there already and is no {form.name} file; choose another folder") from error
    others = sorted(held - own - {Path(name).name for name in own})
    if others:
        raise InputError(
            f"{file}: holds {show(others[0])}, which would be lost; write all frames at once: "
            f"circlecal.export(frames, {form.name!r}, folder)"
        )


def _is_meant_as_folder(path: str | Path) -> bool:
    """Whether a path is one of a folder, which need not exist: it ends in a slash, or in anything but ``.json``."""
    file = Path(path)
    if is_folder(file) or str(path).endswith(("/", os.sep)):
        return True
    return file.suffix.lower() != ".json" and not exists(file)


def _points(points: PointsLike, entries: tuple[int, ...] = (2,)) -> Array:
    given = as_points(points)
    given = given.reshape(0, 2) if given.shape == (0,) else given  # a frame without players
    if given.ndim == 0 or given.shape[-1] not in entries:
        allowed = " or ".join(f"(..., {n})" for n in entries)
        raise ValueError(f"points must be of shape {allowed}, not {given.shape}")
    return given


def _point_sigma(given: PointsLike, points: Array) -> Array:
    """How well each of the points (..., 2) is known, (...,)."""
    sigma = np.asarray(given, dtype=np.float64)
    if not (np.isfinite(sigma).all() and (sigma >= 0.0).all()):
        raise ValueError("point_sigma_px must be finite and not negative")
    try:
        return np.broadcast_to(sigma, points.shape[:-1])
    except ValueError:
        raise ValueError(
            f"point_sigma_px must be a number, or one for each of {points.shape[:-1]} points, not {sigma.shape}"
        ) from None


def _array(value: Matrix | None) -> Array | None:
    return None if value is None else np.asarray(value, dtype=np.float64)
