"""The frames that the workbench lists: of a run, of folders and pictures, of videos; and their pictures."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from circlecal.errors import InputError
from circlecal.files import exists, is_file, real_path, require_input
from circlecal.formats.unpacking import (
    FRAME_SUFFIXES,
    is_archive,
    may_be_annotation,
    places_of,
    require_frames_in,
    tell_others,
)
from circlecal.pictures.archives import unpack
from circlecal.pictures.files import PictureFile, find_frames, read_image
from circlecal.pictures.inputs import expand_inputs
from circlecal.pictures.limits import LimitsConfig
from circlecal.pictures.remote import is_url
from circlecal.pictures.video import Sampling, Video, pictures_at
from circlecal.records.log import RESULTS_NAME, read_records
from circlecal.records.record import ResultRow
from circlecal.rig.venue import VENUE_NAME, read_venue_file

UNPACKED_FOLDER = "frames"
"""In the folder of annotations: pictures of archives."""
DOUBTFUL_PX = 15.0
"""A calibrated frame whose largest predicted error is more, pixels at 1920 px width, is worth a click."""
State = Literal["refused", "doubtful", "calibrated", "unknown"]


@dataclass(frozen=True, slots=True)
class ListedFrame:
    """One frame of the list.

    Attributes
    ----------
    file : PictureFile
        Name, file and time.
    state : {"refused", "doubtful", "calibrated", "unknown"}
        What the run, or the annotation, says of it.
    code, sigma_px : str or None, float or None
        Why it was refused, and the largest predicted error.
    annotated, flag : bool, str or None
        Whether a person changed anything, and what is said of the frame as a whole.
    """

    file: PictureFile
    state: State = "unknown"
    code: str | None = None
    sigma_px: float | None = None
    annotated: bool = False
    flag: str | None = None

    def with_verdict(self, status: str, code: str | None, sigma_px: float | None, width: int) -> ListedFrame:
        """The frame with a verdict."""
        return replace(self, state=state_of(status, sigma_px, width), code=code, sigma_px=sigma_px)


def state_of(status: str, sigma_px: float | None, width: int) -> State:
    """Refused, doubtful or calibrated, by verdict and largest predicted error (pixels of a picture this wide)."""
    if status != "calibrated":
        return "refused"
    return "doubtful" if sigma_px is None or sigma_px > DOUBTFUL_PX * width / 1920.0 else "calibrated"


def is_run(path: Path) -> bool:
    """Whether a folder is that of a run."""
    return path.is_dir() and (path / RESULTS_NAME).is_file()


def find_venue(run: Path) -> Path | None:
    """The file with the cameras that a run found; None where it found none, or each of several clips has its own.

    Raises
    ------
    InputError
        It is damaged.
    """
    own = run / VENUE_NAME
    is_only = is_file(own) and not any(run.glob(f"*.{VENUE_NAME}"))
    return own if is_only and read_venue_file(own).tripods else None


@dataclass(frozen=True, slots=True)
class RunFacts:
    """What the records of a run say of how it was made.

    Attributes
    ----------
    fields : tuple of str
        Templates of its calibrated frames, else of all.
    sizes : dict of str to float
        Of the field, metres; empty where frames differ in them.
    digests : frozenset of str
        Of configurations; empty for runs of rigs and tracks, whose digests cover more.
    """

    fields: tuple[str, ...]
    sizes: dict[str, float]
    digests: frozenset[str]

    @classmethod
    def of(cls, folder: Path) -> RunFacts:
        """Read a run.

        Raises
        ------
        InputError
            It is damaged.
        """
        rows = [row for row in read_records(folder, ResultRow) if row.field is not None]
        rows = [row for row in rows if row.status == "calibrated"] or rows
        fields = {row.field.template: row.field.sizes or {} for row in rows if row.field is not None}
        differ = any(row.field is not None and (row.field.sizes or {}) != fields[row.field.template] for row in rows)
        sizes = next(iter(fields.values()), {}) if len(fields) == 1 and not differ else {}
        plain = [row.config_digest for row in rows if row.rig is None and row.track is None]
        return cls(tuple(fields), sizes, frozenset(digest for digest in plain if digest is not None))


def list_frames(inputs: Sequence[str], sampling: Sampling, limits: LimitsConfig) -> list[ListedFrame]:
    """Frames of runs, pictures, folders of them and videos.

    Parameters
    ----------
    inputs : sequence of str
        As the user names them.
    sampling : Sampling
        Which frames of videos.
    limits : LimitsConfig
        Of videos.

    Raises
    ------
    InputError
        A missing input, a video beyond the limits, a damaged run, a run none of whose pictures is where it was, a URL,
        two frames of one id, or nothing to show.
    """
    found: list[ListedFrame] = []
    others = []
    for given in inputs:
        if is_run(Path(given)):
            found += _frames_of_run(Path(given))
        else:
            others.append(given)
    if others:
        named = expand_inputs(others)
        if named.urls:
            raise InputError(f"{named.urls[0]}: is a URL; save the picture, or run circlecal batch and give its folder")
        for path in named.paths:
            require_input(path)
            if path.name == RESULTS_NAME and is_file(path):
                raise InputError(f"{path}: is the results of a run, not a picture; give its folder, {path.parent}")
        pictures = find_frames(named.paths) if named.paths else []
        found += [ListedFrame(frame) for frame in pictures]
        for path in named.videos:
            video = Video.open(path, path.stem, limits)
            found += [ListedFrame(replace(frame, picture=None)) for frame in video.frames(sampling)]
    if not found:
        raise InputError(f"{', '.join(map(str, inputs))}: holds no frames; give a run, pictures, a folder or a video")
    return _take_once(found)


def _take_once(frames: Sequence[ListedFrame]) -> list[ListedFrame]:
    """The frames, those that are given twice once: the annotation of a frame is found by its id."""
    found: dict[str, ListedFrame] = {}
    for frame in frames:
        first = found.setdefault(frame.file.id, frame).file
        if (real_path(first.path), first.time_s) != (real_path(frame.file.path), frame.file.time_s):
            raise InputError(
                f"{frame.file.id}: is the id of {first.source} and of {frame.file.source}; give them one at a time, "
                "each with an --out of its own"
            )
    return list(found.values())


@dataclass(frozen=True, slots=True)
class ArchivedAnnotations:
    """Files of an archive that may be annotations: as the user names it, the folder that they were unpacked into, and
    where they lie there.
    """

    given: str
    folder: Path
    files: list[Path]


def unpack_inputs(
    inputs: Sequence[str], folder: Path, aside: Path, tell: Callable[[str], None]
) -> tuple[list[str], list[ArchivedAnnotations]]:
    """The inputs, ZIP archives of pictures and videos among them as the folders into which they were unpacked, and the
    annotations that archives hold.

    Parameters
    ----------
    inputs : sequence of str
        As the user names them.
    folder, aside : path
        Each archive has a folder of its name below them, of its pictures and of its annotations; what is there already
        is not written again.
    tell : callable
        Called with what is left out of an archive.

    Raises
    ------
    InputError
        An archive is damaged, encrypted, far too large, or holds neither pictures nor videos nor annotations.
    """
    archives = [path for path in dict.fromkeys(map(Path, inputs)) if is_archive(path)]
    places = dict(zip(archives, places_of(archives, folder), strict=True))
    found, annotated = [], []
    for given in inputs:
        place = places.get(Path(given))
        if place is None:
            found.append(given)
            continue
        beside = aside / place.name

        def folder_of(path: PurePosixPath, place: Path = place, beside: Path = beside) -> Path | None:
            return place if path.suffix.lower() in FRAME_SUFFIXES else beside if may_be_annotation(path) else None

        unpacked = unpack(Path(given), given, folder_of)
        require_frames_in(given, is_any=bool(unpacked.files))
        for warning in unpacked.warnings(given):
            tell(warning)
        tell_others(given, unpacked.others, tell)
        named = [path for path in unpacked.files if path.is_relative_to(beside)]
        if len(named) < len(unpacked.files):
            found.append(str(place))
        if named:
            annotated.append(ArchivedAnnotations(given, beside, named))
    return found, annotated


def take_part(frames: list[ListedFrame], part: str | None) -> list[ListedFrame]:
    """The frames of one of several people: of ``"2/4"`` about every fourth one; all where None.

    They are dealt by a digest of their ids: who has a frame keeps it, whatever joins the folder or leaves it.

    Raises
    ------
    InputError
        The part is none, or has no frames.
    """
    if part is None:
        return frames
    found = re.fullmatch(r"([1-9]\d{0,5})/([1-9]\d{0,5})", part)
    if found is None or int(found[1]) > int(found[2]):
        raise InputError(f"--part {part}: must be K/N such as 2/4, the second of four parts")
    chosen = sorted((f for f in frames if _deal(f.file.id, int(found[2])) == int(found[1])), key=lambda f: f.file.id)
    if not chosen:
        raise InputError(f"--part {part}: is empty; there are {len(frames)} frames")
    return chosen


def _deal(frame_id: str, people: int) -> int:
    """Who of so many people, from 1, has a frame."""
    return int.from_bytes(hashlib.sha256(frame_id.encode(errors="surrogateescape")).digest()[:8], "big") % people + 1


def _frames_of_run(folder: Path) -> list[ListedFrame]:
    rows = {record.id: record for record in read_records(folder, ResultRow)}
    frames = [_row_of(record) for record in rows.values() if record.path]
    files = [frame.file.path for frame in frames if frame.file.url is None]
    if files and not any(map(exists, files)):
        raise InputError(
            f"{folder}: its pictures are not where they were ({files[0]}, ...); put them back, or start circlecal "
            "annotate in the folder in which the run was started"
        )
    return frames


def _row_of(record: ResultRow) -> ListedFrame:
    path, camera = record.path or "", record.estimated_camera
    time_s = None if record.source is None else record.source.time_s
    url = path if is_url(path) else None
    file = PictureFile(record.id, Path(path), record.id, time_s=time_s, url=url)
    sigma = None if camera is None else camera.max_sigma_px
    return ListedFrame(file).with_verdict(record.status, record.code, sigma, record.picture_width or 1920)


def tell_pixels(frame: PictureFile, limits: LimitsConfig) -> PictureFile:
    """A listed frame with the shape of its pixels, where it is of a video that tells it.

    Raises
    ------
    InputError
        The video cannot be read, is beyond the limits, or has moved.
    """
    if frame.time_s is None or frame.aspect is not None:
        return frame
    return replace(frame, aspect=Video.open(frame.path, frame.id, limits).aspect)


def picture_of(frame: PictureFile, limits: LimitsConfig) -> NDArray[np.uint8]:
    """The picture of a listed frame, BGR.

    Raises
    ------
    InputError
        It cannot be read, is beyond the limits, or has moved.
    """
    if frame.url is not None:
        raise InputError(f"{frame.url}: is an address; the workbench reads local pictures only")
    if frame.time_s is None:
        return read_image(frame.path, limits)
    picture = next(pictures_at(frame.path, [frame.time_s]))
    if picture is None:
        raise InputError(f"{frame.path}: the frame at {frame.time_s:.3f} s cannot be decoded")
    return picture
