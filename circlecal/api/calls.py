"""Calibrating a picture, a video or points from Python."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from dataclasses import replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from circlecal import results
from circlecal.api.calibration import Calibration
from circlecal.config import AUTO, Config, load_config, suit_config, suit_pixels
from circlecal.errors import ConfigError, InputError
from circlecal.field import FieldTemplate
from circlecal.files import is_file
from circlecal.formats.annotation import Annotation
from circlecal.formats.cameras import as_size
from circlecal.formats.inputs import observations_beside, observe_network
from circlecal.formats.meaning import NO_MARKING, REACH, REFERENCE_WIDTH_PX, names_a_point, observe
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.geometry.projective import PointsLike
from circlecal.observations import Keypoint, Observations, join_observations
from circlecal.pictures.files import PICTURE_SUFFIXES, PictureFile, as_bgr, read_image
from circlecal.pictures.inputs import is_video
from circlecal.pictures.masks import as_class_ids, read_mask
from circlecal.pictures.video import Sampling, Video
from circlecal.pipeline import Convention, apply_convention, calibrate_image, field_of, run_observations
from circlecal.records.writing import result_record
from circlecal.refusals import REFUSALS

Points = Mapping[Any, PointsLike]
"""Pixels by the name of a marking or point of the field, or by a field point in metres."""
Settings = Mapping[str, Any]
"""Options by ``"section.key"``."""

CLICKED_SIGMA_PX = 1.5
"""Standard deviation of points that people click, pixels at 1920 px width; as for annotation files."""

FARTHEST_LENGTHS = 3
"""Of a point of the field from the field's middle, in lengths of the field: what lies further away is in another unit,
or damaged.
"""

_OF_CV2 = "; cv2.imread returns None where it cannot read the file"
_log = logging.getLogger(__name__)


def calibrate(
    image: NDArray[Any] | str | Path,
    config: Config | str | Path | None = None,
    *,
    field: str | Path | None = None,
    set: Settings | None = None,
    mask: NDArray[Any] | str | Path | None = None,
    points: Points | str | Path | None = None,
    id: str | None = None,
) -> Calibration:
    """Calibrate the camera of one picture.

    Parameters
    ----------
    image : array or path
        Picture file, or an array as ``cv2.imread`` gives it: (H, W, 3) BGR, (H, W, 4) BGRA or (H, W) gray, of 8 or 16
        bit. Pictures from elsewhere are mostly RGB: ``np.asarray(picture)[..., ::-1]``.
    config : Config, str or path, optional
        A configuration, the name of one that comes with circlecal such as ``"broadcast"``, or a YAML file. That of a
        camera which is known comes from :func:`circlecal.load_cameras`.
    field : str or path, optional
        Field template: a name such as ``"futsal"``, or a YAML file; ``"auto"`` for the one that the picture shows.
    set : mapping, optional
        Options over the configuration, such as ``{"camera.roll_sd_deg": 1, "seed": 3}``.
    mask : array or path, optional
        Where the markings are: binary (all of them, or the circle alone), SoccerNet class ids or SoccerNet palette,
        any size. What it has no lines for is looked for in the picture. Without one the built-in detector looks for
        them (a mask file beside the picture is not looked for).
    points : mapping or path, optional
        What is known of the picture already, as for :func:`calibrate_points` but in one mapping, or a file of
        annotations or keypoints. They count as points on the middle of the paint (the convention ``"paint"`` there),
        which the picture itself shows; points at the sizes of the rules are for :func:`calibrate_points` alone.
    id : str, optional
        Name of the frame, which changes no answer. The file's stem, or ``"image"``, when None.

    Returns
    -------
    Calibration
        A frame that cannot be calibrated is refused, not an exception: see ``ok``, ``reason`` and ``help``.

    Raises
    ------
    InputError
        The picture, the mask or the points are unusable; a video where a picture is meant.
    ConfigError
        The configuration, its field template or a network is unusable.
    MissingExtraError
        The configuration names a network, and the package that runs it is not installed.
    TypeError
        The picture is neither an array nor a path, as the None of ``cv2.imread`` for a file that it cannot read; or a
        mask, a name, a configuration or settings of another kind.
    """
    chosen = configure(config, field, set)
    if not isinstance(image, np.ndarray | str | PathLike):
        raise TypeError(f"image must be an array or a path, not {type(image).__name__}{_OF_CV2 * (image is None)}")
    if mask is not None and not isinstance(mask, np.ndarray | str | PathLike):
        raise TypeError(f"mask must be an array or a path, not {type(mask).__name__}")
    image = image if isinstance(image, np.ndarray) else fspath(image)
    source = None if isinstance(image, np.ndarray) else image
    if source is not None and is_file(Path(source)) and is_video(Path(source)):
        raise InputError(f"{source}: is a video; circlecal.calibrate_video takes it")
    picture = as_bgr(image, "image") if isinstance(image, np.ndarray) else read_image(image)
    name = _name_frame(id, "image" if source is None else Path(source).stem)
    height, width = picture.shape[:2]
    template, _ = field_of(chosen)
    if points is None:
        given = None
    elif isinstance(points, Mapping):
        given = observe_points(points, template, chosen, (width, height))
    elif not isinstance(points, str | PathLike):
        raise InputError(f"points: takes pixels by the name of what they show, or a file, not {type(points).__name__}")
    else:
        frame = PictureFile(name, Path(source or name), name)
        given = observations_beside(Path(points), frame, template, chosen.sources, (width, height))
    if mask is None:
        classes = None
    elif isinstance(mask, np.ndarray):
        classes = as_class_ids(mask, width, height, "mask")
    else:
        classes = read_mask(Path(mask), width, height)
    found = calibrate_picture(picture, chosen, mask=classes, given=given, frame_id=name, source=source)
    template = found.template or template
    held = image if isinstance(image, np.ndarray) else None
    return Calibration(result_record(found, template), template, found=found, image=held)


def calibrate_picture(
    picture: NDArray[np.uint8],
    config: Config,
    *,
    mask: NDArray[np.uint8] | None = None,
    given: Observations | None = None,
    aspect: float | None = None,
    frame_id: str,
    source: str | None = None,
) -> results.FrameCalibration:
    """Calibrate a picture with what is given beside it and what the networks of the configuration find in it.

    Parameters
    ----------
    picture : (H, W, 3) uint8
        BGR.
    config : Config
        Options of every stage.
    mask : (H, W) uint8, optional
        SoccerNet class ids.
    given : Observations, optional
        Points and lines from elsewhere.
    aspect : float, optional
        Width of a pixel over its height, where the picture's file tells and the configuration does not.
    frame_id, source : str
        As for :func:`circlecal.pipeline.run`.

    Raises
    ------
    ConfigError
        The configuration's field template or a network is unusable.
    InputError
        The mask is not of the picture's size.
    """
    config = suit_pixels(config, aspect)
    extra = observe_network(picture, config.keypoints, field_of(config)[0], config.sources)
    if given is not None:
        extra = given if extra is None else join_observations(extra, given)
    return calibrate_image(picture, config, mask=mask, extra=extra, frame_id=frame_id, source=source)


def calibrate_annotation(
    annotation: Annotation, config: Config, *, nameless: bool = True, earlier: results.CameraFit | None = None
) -> results.FrameCalibration:
    """Calibrate a frame from its annotation alone: what was measured in it, and what a person said it is.

    Parameters
    ----------
    annotation : Annotation
        Of the workbench.
    config : Config
        Options of every stage; the annotation's own settings go over them.
    nameless : bool
        Whether lines that nobody named are recognised and used too.
    earlier : CameraFit, optional
        Camera of nearly the same annotation, from which the fit starts.

    Returns
    -------
    FrameCalibration
        Refused where the person says that there is no field, or another camera.

    Raises
    ------
    ConfigError
        The annotation's settings contradict the configuration.
    """
    chosen = load_config(config, annotation.settings) if annotation.settings else config
    chosen = _suit_circle(suit_pixels(chosen, annotation.pixel_aspect), annotation)
    seen = observe(annotation.frame(nameless), field_of(chosen)[0], chosen.sources, "workbench", annotation.id)
    observations, name, source = seen.observations, annotation.id, annotation.source
    if annotation.flag is not None:
        observations = Observations(annotation.width, annotation.height)
    try:
        found = run_observations(
            observations,
            chosen,
            frame_id=name,
            source=source,
            convention="paint",
            earlier=earlier,
            is_placed=annotation.placed,
        )
    except np.linalg.LinAlgError:  # names that contradict each other so much that no camera is near any of them
        found = run_observations(
            Observations(annotation.width, annotation.height), chosen, frame_id=name, source=source
        )
    if annotation.flag is None:
        return found
    verdict = results.Verdict("refused", annotation.flag, REFUSALS[annotation.flag].words, "input")
    return replace(found, attempt=results.Attempt(observations=observations, verdict=verdict))


def _suit_circle(config: Config, annotation: Annotation) -> Config:
    """The configuration with the circle from which the picture was calibrated, where it names none itself and that
    circle is still among what is used.
    """
    circle = annotation.circle
    is_used = any(marking.used and marking.name == circle for marking in annotation.markings)
    if config.field.circle is not None or not is_used or circle not in field_of(config)[0].circle_by_name:
        return config
    return config.model_copy(update={"field": config.field.model_copy(update={"circle": circle})})


def suit_annotation(config: Config, annotation: Annotation) -> Config:
    """The configuration for the field on which an annotation was made, where the configuration names none.

    Parameters
    ----------
    config : Config
        Options of every stage.
    annotation : Annotation
        Of the workbench.

    Raises
    ------
    InputError
        The configuration names another field, or the annotation's field is no template and no file here.
    """
    field, named = annotation.field, config.field.template
    if "field" not in annotation.model_fields_set or field == named or Path(field).name == Path(named).name:
        return config
    is_named = named != AUTO and "field" in config.model_fields_set and "template" in config.field.model_fields_set
    if is_named:
        raise InputError(
            f"{annotation.id}: was annotated on the field {field}, not on {named}; give --field {field}, or move the "
            "annotation away"
        )
    try:
        return suit_config(config, field)
    except ConfigError as error:
        raise InputError(f"{annotation.id}: its field cannot be read: {error}; name it with --field") from error


def calibrate_points(
    *,
    size: tuple[int, int],
    circle: PointsLike | Mapping[str, PointsLike] | None = None,
    lines: Mapping[str, PointsLike] | None = None,
    keypoints: Points | None = None,
    sigma_px: float | None = None,
    convention: Convention = "official",
    config: Config | str | Path | None = None,
    field: str | Path | None = None,
    set: Settings | None = None,
    id: str | None = None,
) -> Calibration:
    """Calibrate the camera from points that somebody clicked or detected, without a picture.

    Parameters
    ----------
    size : (int, int)
        Width and height of the picture, pixels.
    circle : (N, 2) array or mapping, optional
        Pixels along the circle; along several circles and arcs by their names, such as ``"penalty_arc_left"``.
    lines : mapping, optional
        Pixels (N, 2), two or more, along straight markings by their names, such as ``"halfway_line"``.
    keypoints : mapping, optional
        The pixel (2,) of a mark (``"centre_mark"``), of a point of a circle by its direction on the map
        (``"centre_circle top"``), of the meet of two lines (``"halfway_line x side_line_top"``), or of a field point in
        metres (``(0.0, -34.0)``).
    sigma_px : float, optional
        Standard deviation of the points, pixels; 1.5 px of a picture 1920 px wide when None.
    convention : {"official", "paint"}
        Where the points of markings lie: ``"official"`` at the sizes of the rules, as points that were projected from a
        model and SoccerNet's annotations do; ``"paint"`` on the middle of the paint, where people click. The wrong one
        of the two costs about 0.1 m.
    config, field, set : optional
        As for :func:`calibrate`; without a picture nothing tells the field, so it cannot be ``"auto"``.
    id : str, optional
        Name of the frame; ``"points"`` when None.

    Returns
    -------
    Calibration
        Refused where the points leave the camera open.

    Raises
    ------
    InputError
        A name that the field does not have or that two arguments have, something that is no point, several pixels of
        one point, a point of the field or a pixel that lies far outside, or a picture without a width or height.
    ConfigError, TypeError
        As for :func:`calibrate`, of the configuration and the name; or the field is ``"auto"``.
    """
    chosen = configure(config, field, set)
    if chosen.field.template == AUTO:
        raise ConfigError(f"field: {AUTO} is for pictures, which tell their field; name the field of the points")
    name = _name_frame(id, "points")
    if convention not in get_args(Convention):
        raise InputError(f"convention: {convention!r} is neither {' nor '.join(map(repr, get_args(Convention)))}")
    template, seen = field_of(chosen)
    circles = circle if circle is None or isinstance(circle, Mapping) else {seen.name: circle}
    given = _join_points(circle=circles, lines=lines, keypoints=keypoints)
    template = apply_convention(template, convention)
    observations = observe_points(given, template, chosen, size, sigma_px)
    found = run_observations(observations, chosen, frame_id=name, convention=convention)
    return Calibration(result_record(found, template), template, found=found)


def _name_frame(given: str | None, usual: str) -> str:
    """Name of a frame that a caller gave or not.

    Raises
    ------
    TypeError
        It is no text: results are found by it when they are read back.
    """
    if given is not None and not isinstance(given, str):
        raise TypeError(f"id must be a text, not {given!r}; give str({given!r})")
    return given or usual


def _join_points(**arguments: Points | None) -> Points:
    """What several arguments say in one mapping.

    Raises
    ------
    InputError
        One is no mapping, or two name one marking.
    """
    joined: dict[Any, PointsLike] = {}
    argument_of: dict[Any, str] = {}
    for name, points in arguments.items():
        if points is None:
            continue
        if not isinstance(points, Mapping):
            raise InputError(f"{name}: takes pixels by the name of what they show, not {type(points).__name__}")
        for place in points:
            if place in argument_of:
                raise InputError(f"{place}: is given in {argument_of[place]} and in {name}; give all its pixels in one")
            argument_of[place] = name
        joined |= points
    return joined


def calibrate_video(
    path: str | Path,
    config: Config | str | Path | None = None,
    *,
    every: str | int = "1s",
    start: str | float | None = None,
    end: str | float | None = None,
    field: str | Path | None = None,
    set: Settings | None = None,
) -> Iterator[Calibration]:
    """Calibrate frames of a video, one after the other as they are asked for.

    Parameters
    ----------
    path : path
        The video.
    every : str or int
        A time such as ``"1s"`` or ``"500ms"``, or a number of frames.
    start, end : str or float, optional
        Times in the video: seconds, ``"1:30"`` or ``"0:01:30.5"``; a frame at ``end`` itself is left out.
    config, field, set : optional
        As for :func:`calibrate`.

    Yields
    ------
    Calibration
        With ``time_s``; its ``image`` is at hand until the next one is asked for.

    Raises
    ------
    InputError
        The file is missing, is a picture, or no video; or a time that is none.
    ConfigError, MissingExtraError, TypeError
        As for :func:`calibrate`; a path that is none.
    """
    chosen = configure(config, field, set)
    template, _ = field_of(chosen)
    sampling = Sampling.parse(every, start, end)
    video = open_video(path, chosen)
    return _calibrations(video, sampling, chosen, template)


def open_video(path: str | Path, config: Config) -> Video:
    """A video that a caller names.

    Raises
    ------
    InputError
        It cannot be read, or is a picture.
    TypeError
        It is no path.
    """
    if not isinstance(path, str | PathLike):
        raise TypeError(f"path must be that of a video, not {type(path).__name__}")
    file = Path(path)
    if file.suffix.lower() in PICTURE_SUFFIXES:
        raise InputError(f"{path}: is a picture; circlecal.calibrate takes it")
    return Video.open(file, file.stem, config.limits)


def _calibrations(video: Video, sampling: Sampling, config: Config, template: FieldTemplate) -> Iterator[Calibration]:
    for frame in video.frames(sampling, lambda error: _log.warning("%s", error)):
        picture = frame.picture
        if picture is None:
            continue
        found = calibrate_picture(picture, config, aspect=frame.aspect, frame_id=frame.id, source=frame.source)
        seen = found.template or template
        yield Calibration(result_record(found, seen, time_s=frame.time_s), seen, found=found, image=picture)


def configure(config: Config | str | Path | None, field: str | Path | None, settings: Settings | None) -> Config:
    """The configuration that the arguments of :func:`calibrate` add up to.

    Raises
    ------
    ConfigError
        As :func:`circlecal.config.load_config`.
    TypeError
        A configuration or settings of another kind.
    """
    if config is not None and not isinstance(config, Config | str | PathLike):
        raise TypeError(f"config takes a Config, a name or a file, not {config!r}; set takes single options")
    if settings is not None and not isinstance(settings, Mapping):
        raise TypeError(f"set takes a mapping such as {{'camera.roll_sd_deg': 1}}, not {settings!r}")
    chosen = dict(settings or {}) | ({} if field is None else {"field.template": str(field)})
    if isinstance(config, Config) and not chosen:
        return config
    return load_config(config, chosen)


def observe_points(
    points: Points,
    template: FieldTemplate,
    config: Config,
    size: tuple[int, int],
    sigma_px: float | None = None,
) -> Observations:
    """Observations of points by the name of what they show, or by their place on the field.

    Parameters
    ----------
    points : mapping
        Pixels (N, 2), or one (2,), by name or field point.
    template : FieldTemplate
        The field.
    config : Config
        For its sources.
    size : (int, int)
        Width and height of the picture, pixels.
    sigma_px : float, optional
        Standard deviation of the points; that of clicked points when None.

    Raises
    ------
    InputError
        A name that the field does not have, something that is no point, a line of one point, several pixels of one
        point, or a picture without a width or height.
    """
    width, height = as_size(size)
    if sigma_px is not None and not (isinstance(sigma_px, int | float | np.number) and 0.0 < sigma_px < np.inf):
        raise InputError(f"sigma_px must be a standard deviation in pixels above 0, not {sigma_px!r}")
    sigma = CLICKED_SIGMA_PX * width / REFERENCE_WIDTH_PX if sigma_px is None else sigma_px
    shapes, keypoints = [], []
    for place, value in points.items():
        try:
            pixels = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"{place}: is no pixel (2,) and no list of pixels (N, 2)") from error
        if pixels.size and pixels.shape[-1:] != (2,):
            shape = " x ".join(map(str, pixels.shape)) or "a single number"
            raise InputError(f"{place}: pixels must be (N, 2), column and row of each, not {shape}")
        pixels = pixels.reshape(-1, 2)
        if not np.isfinite(pixels).all():
            raise InputError(f"{place}: holds a pixel that is not finite")
        if place in template.line_by_name and len(pixels) and np.ptp(pixels, axis=0).max() == 0:
            raise InputError(f"{place}: is a line of one point; give two or more")
        if isinstance(place, str):
            if len(pixels) > 1 and names_a_point(place, template):
                raise InputError(f"{place}: is one point of the field, and {len(pixels)} pixels are given; give one")
            shapes.append(Shape(place, "points", pixels))
        else:
            x, y = _field_point(place, template)
            if len(pixels) > 1:
                raise InputError(f"{place}: is one point of the field, and {len(pixels)} pixels are given; give one")
            if np.abs(pixels).max(initial=0.0) > REACH * max(width, height):
                raise InputError(f"{place}: its pixel lies more than {REACH} pictures away")
            keypoints += [Keypoint(f"({x:.10g}, {y:.10g}) m", np.array([x, y]), pixel, sigma) for pixel in pixels]
    sources = config.sources.model_copy(update={"sigma_px": {"points": sigma * REFERENCE_WIDTH_PX / width}})
    observed = observe(AnnotatedFrame("points", width, height, tuple(shapes)), template, sources, "points", "points")
    if observed.warnings:
        told = observed.warnings[0].removesuffix("; left out")
        names = ", ".join(e.name for e in template.elements)
        raise InputError(f"{told}; known: {names}" if NO_MARKING in told else told)
    return join_observations(observed.observations, Observations(width, height, keypoints=tuple(keypoints)))


def _field_point(place: Any, template: FieldTemplate) -> tuple[float, float]:
    """A point of the field, metres, of somebody's own mapping.

    Raises
    ------
    InputError
        It is no point, or lies nowhere near the field.
    """
    try:
        x, y = (float(value) for value in place)
    except (TypeError, ValueError) as error:
        raise InputError(f"{place}: is neither a name nor a point (x, y) of the field in metres") from error
    if not np.isfinite([x, y]).all():
        raise InputError(f"{place}: is a point of the field that is not finite")
    if np.hypot(x, y) > FARTHEST_LENGTHS * template.length_m:
        raise InputError(
            f"{place}: lies more than {FARTHEST_LENGTHS} lengths of the field ({template.length_m:.10g} m) from its "
            "middle; field points are in metres"
        )
    return x, y
