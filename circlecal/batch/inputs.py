"""What a run over many frames calibrates: pictures, frames of annotation files, and videos."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from circlecal.batch.frames import FrameRun
from circlecal.errors import InputError
from circlecal.files import exists, is_folder, real_path
from circlecal.formats.annotation import digest_annotations, find_annotation
from circlecal.formats.inputs import (
    FrameOfFile,
    find_file_beside,
    find_unused_annotations,
    read_frames,
    refuse_overwriting,
    split_inputs,
)
from circlecal.formats.registry import annotation_suffixes, read_annotations
from circlecal.formats.unpacking import is_archive, unpack_archives
from circlecal.pictures.files import NoFramesError, PictureFile, distinct_names, find_frames
from circlecal.pictures.inputs import VIDEO_SUFFIXES, Inputs, expand_inputs
from circlecal.pictures.remote import url_names
from circlecal.pictures.video import DEFAULT_EVERY, Sampling, Video, clip_of
from circlecal.pipeline import apply_convention, field_of
from circlecal.records.log import RESULTS_NAME, read_records
from circlecal.records.record import ResultRow

ANY_SIZE = 1920, 1080
"""For a look into a file whose pixels do not count yet."""


@dataclass(frozen=True, slots=True)
class Work:
    """What a run calibrates: frames of pictures and annotation files, and videos with what is taken of them."""

    frames: Sequence[PictureFile | FrameOfFile]
    videos: Sequence[Video]
    sampling: Sampling

    def all_frames(self, on_error: Callable[[str], None]) -> Iterator[PictureFile | FrameOfFile]:
        """The frames, those of videos after the others, decoded as they are asked for."""
        moments = (frame for video in self.videos for frame in video.frames(self.sampling, on_error))
        return chain(self.frames, moments)

    @property
    def total(self) -> int:
        """About how many frames these are."""
        return len(self.frames) + sum(video.estimate_count(self.sampling) for video in self.videos)


def choose_work(
    inputs: Sequence[str],
    run: FrameRun,
    out: Path,
    moments: tuple[str | int | None, str | float | None, str | float | None],
    report: Callable[[Exception], None],
    note: Callable[[str], None],
    dashes: str = "",
) -> Work:
    """What the inputs name.

    Parameters
    ----------
    inputs : sequence of str
        As :func:`circlecal.pictures.inputs.expand_inputs` takes them.
    run : FrameRun
        What is done with each frame.
    out : path
        Folder of the run, of which nothing is taken.
    moments : (every, start, end)
        What is taken of videos; one frame per second, from their beginning to their end, where they are None.
    report, note : callable
        Called with the error of each input that cannot be read, and with what is worth a note.
    dashes : str
        What stands before the names of options in errors.

    Raises
    ------
    InputError
        Nothing to calibrate, or times are given without a video.
    """
    errors: list[Exception] = []

    def keep(error: Exception) -> None:
        errors.append(error)
        report(error)

    frames, videos = choose_frames_and_videos(inputs, run, out, keep, note)
    if not videos and not errors:
        require_frames(inputs, frames)
    every, start, end = moments
    sampling = Sampling.parse(every or DEFAULT_EVERY, start, end, dashes=dashes)
    if not videos and (every or start or end):
        raise InputError(f"{dashes}every, {dashes}start and {dashes}end choose frames of videos, and no video is given")
    return Work(frames, videos, sampling)


def choose_frames_and_videos(
    inputs: Sequence[str],
    run: FrameRun,
    out: Path,
    report: Callable[[Exception], None],
    note: Callable[[str], None],
) -> tuple[list[PictureFile | FrameOfFile], list[Video]]:
    """Pictures, frames of annotation files, and videos among the inputs.

    Raises
    ------
    InputError
        Nothing was found that can be read.
    """
    named = expand_frames(inputs, run, out, note)
    names = distinct_names([path.stem for path in named.videos])
    videos = []
    for video, name in zip(named.videos, names, strict=True):
        try:
            videos.append(Video.open(video, name, run.config.limits))
        except InputError as error:
            if len(named.videos) == 1 and not named.paths and not named.urls:
                raise
            report(error)
    for path in (run.mask, run.keypoints):
        if videos and path is not None and not is_folder(path):
            raise InputError(f"{path}: is one file for all frames of a video; give a folder of files named like them")
    alone = (named.videos or named.urls) and not named.paths
    try:
        frames = [] if alone else choose_frames_of(named.paths, run, out, report, note)
    except NoFramesError:
        if not videos:  # in a folder of videos lies what was written of them
            raise
        frames = []
    urls = _urls_of_pictures(named, report)
    ids = url_names(urls, [frame.id for frame in frames])
    frames += [PictureFile(name, Path(name), name, url=url) for name, url in zip(ids, urls, strict=True)]
    return frames, videos


def expand_frames(inputs: Sequence[str], run: FrameRun, out: Path, note: Callable[[str], None]) -> Inputs:
    """What is named; of ZIPs the folders in ``out`` into which they were unpacked. In a folder of videos annotations
    are frames only where the user names their format: mostly they are what a command wrote of the videos.

    Raises
    ------
    InputError
        As :func:`circlecal.pictures.inputs.expand_inputs` and :func:`circlecal.formats.unpacking.unpack_archives`.
    """
    is_named = run.format_name is not None and run.keypoints is None
    suffixes = annotation_suffixes() if is_named else ()
    named = expand_inputs(inputs, suffixes)
    archives = [path for path in named.paths if is_archive(path)]
    held = expand_inputs(unpack_archives(archives, out, note), suffixes)
    others = [path for path in named.paths if path not in archives]
    return Inputs([*others, *held.paths], [*named.videos, *held.videos], named.urls)


def choose_frames(inputs: Sequence[Path], out: Path, mask: Path | None) -> list[PictureFile]:
    """The frames among the inputs.

    Raises
    ------
    InputError
        As :func:`circlecal.pictures.files.find_frames`, or the mask option does not fit.
    """
    if mask is not None and not exists(mask):
        raise InputError(f"{mask}: no such mask file or folder")
    around_inputs = {folder for path in inputs for folder in (real_path(path), *real_path(path).parents)}
    apart = [path for path in (out, mask) if path is not None and real_path(path) not in around_inputs]
    frames = find_frames(inputs, exclude=apart)
    if mask is not None and not is_folder(mask) and len(frames) > 1:
        raise InputError(f"{mask}: is one mask for {len(frames)} frames; give a folder of masks named like the frames")
    return frames


def require_frames(inputs: Sequence[object], frames: Sequence[object]) -> None:
    """There is something to calibrate: pictures, or frames in the annotation files that were named.

    Raises
    ------
    InputError
        There is not.
    """
    if not frames:
        named = ", ".join(map(str, inputs))
        raise InputError(f"{named}: no annotations found; give pictures, annotation files or folders of them")


def choose_frames_of(
    inputs: Sequence[Path],
    run: FrameRun,
    out: Path,
    report: Callable[[Exception], None],
    note: Callable[[str], None],
) -> list[PictureFile | FrameOfFile]:
    """Pictures, and frames of annotation files, in what is named; files that cannot be read are reported.

    Raises
    ------
    InputError
        Nothing to calibrate, an option that does not fit, or a result that would be written over its source.
    """
    if run.keypoints is not None and not exists(run.keypoints):
        raise InputError(f"{run.keypoints}: no such file or folder of keypoints")
    format_name = None if run.keypoints is not None else run.format_name
    pictures, files = split_inputs(inputs, format_name, exclude=[out])
    frames = choose_frames(pictures, out, run.mask) if pictures else []
    _require_keypoints_of_each(frames, run)
    note_unused_annotations(frames if run.keypoints is None else (), note)
    if run.keypoints is not None and not frames:
        raise InputError(f"{run.keypoints}: --keypoints are used together with pictures, and no picture is given")
    template, _ = field_of(run.config)
    annotated = read_frames(
        files,
        apply_convention(template, run.convention),
        run.config.sources,
        painted=template,
        size=run.size,
        format_name=format_name,
        taken=[frame.id for frame in frames],
        on_error=report,
    )
    refuse_overwriting(annotated, out)
    return [*frames, *annotated]


def _require_keypoints_of_each(frames: Sequence[PictureFile], run: FrameRun) -> None:
    """No file with the keypoints of one frame is given for several pictures.

    Raises
    ------
    InputError
        One is.
    """
    given = run.keypoints
    if given is None or len(frames) <= 1:
        return
    if not is_folder(given):
        if _holds_one_frame(given, run):
            told = f"{given}: holds one frame for {len(frames)} pictures"
            raise InputError(f"{told}; give a folder of files named like the pictures")
        return
    names = Counter(frame.stem for frame in frames)
    alike = [frame for frame in frames if names[frame.stem] > 1]
    first: dict[Path, PictureFile] = {}
    for frame in alike:
        path = find_file_beside(given, frame, run.format_name)
        if path is None:
            continue
        other = first.setdefault(path, frame)
        if other is not frame and _holds_one_frame(path, run):
            told = f"{path}: holds one frame, and may be of {other.mask_stem} and {frame.mask_stem}"
            raise InputError(f"{told}; put it in a folder named like that of its picture")


def _holds_one_frame(path: Path, run: FrameRun) -> bool:
    try:
        _, found = read_annotations(path, run.size or ANY_SIZE, run.format_name)
    except InputError:  # told with each frame
        return False
    return len(found) == 1


def _urls_of_pictures(named: Inputs, report: Callable[[Exception], None]) -> list[str]:
    """The URLs among what is named, without those of videos, which are reported.

    Raises
    ------
    InputError
        Nothing but URLs of videos is named.
    """
    videos = [url for url in named.urls if url.lower().endswith(VIDEO_SUFFIXES)]
    for url in videos:
        error = InputError(f"{url}: is the URL of a video; save the video, and give its file")
        if len(named.urls) == len(videos) and not named.paths and not named.videos:
            raise error
        report(error)
    return [url for url in named.urls if url not in videos]


def note_unused_annotations(frames: Sequence[PictureFile], note: Callable[[str], None]) -> None:
    """Say that annotations of other programs lie beside pictures and are not used.

    They are not taken unasked, as masks are: beside pictures lies what they are evaluated with.
    """
    ignored = find_unused_annotations(frames)
    if ignored:
        more = f" and {len(ignored) - 1} more" if len(ignored) > 1 else ""
        note(
            f"{ignored[0]}{more}: an annotation beside its picture is not used; --keypoints FOLDER takes it together "
            "with the picture, and the file itself as an input takes it alone"
        )


def digest_annotations_of(work: Work, folder: Path | None, out: Path) -> dict[str, str | None]:
    """Digest of what people said of each frame that the inputs name, by its id; None where nobody did. Of the frames of
    videos, which are not decoded yet, those are told of which somebody says something, or did in an earlier start.
    """
    clips = {video.name for video in work.videos}
    before = read_records(out, ResultRow) if clips and (out / RESULTS_NAME).is_file() else ()
    told: dict[str, str | None] = {row.id: None for row in before if row.annotation and clip_of(row.id) in clips}
    named = digest_annotations(folder, on_error=lambda _: None)  # a damaged one is told with its frame
    told |= {name: digest for name, digest in named.items() if clip_of(name) in clips}
    for frame in work.frames:
        if isinstance(frame, PictureFile):
            with suppress(InputError):  # likewise
                stored = find_annotation(folder, frame.id, frame.path if frame.url is None else None)
                told[frame.id] = None if stored is None else stored.digest
    return told
