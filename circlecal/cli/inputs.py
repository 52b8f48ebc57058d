"""What the inputs of a command are: frames of pictures and annotation files, and videos."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from circlecal.batch.frames import FrameRun
    from circlecal.formats.inputs import FrameOfFile
    from circlecal.pictures.files import PictureFile
    from circlecal.pictures.inputs import Inputs
    from circlecal.pictures.limits import LimitsConfig
    from circlecal.pictures.video import Sampling, Video

ANY_SIZE = 1920, 1080
"""For a look into a file whose pixels do not count yet."""


def choose_frames(inputs: Sequence[Path], out: Path, mask: Path | None) -> list[PictureFile]:
    """The frames among the inputs.

    Raises
    ------
    InputError
        As :func:`circlecal.pictures.files.find_frames`, or the mask option does not fit.
    """
    from circlecal.errors import InputError
    from circlecal.files import exists, is_folder, real_path
    from circlecal.pictures.files import find_frames

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
    from circlecal.errors import InputError

    if not frames:
        named = ", ".join(map(str, inputs))
        raise InputError(f"{named}: no annotations found; give pictures, annotation files or folders of them")


def choose_inputs(
    inputs: Sequence[str], run: FrameRun, out: Path, report: Callable[[Exception], None]
) -> list[PictureFile | FrameOfFile]:
    """Pictures and frames of annotation files among the inputs; videos, URLs and files that cannot be read are
    reported.

    Raises
    ------
    InputError
        Nothing to calibrate, an option that does not fit, or a result that would be written over its source.
    """
    named = _expand_frames(inputs, run)
    leave_to_batch(named, report)
    return _frames_of(named.paths, run, out, report)


def _expand_frames(inputs: Sequence[str], run: FrameRun) -> Inputs:
    """What is named. In a folder of videos annotations are frames only where the user names their format: mostly they
    are what a command wrote of the videos.
    """
    from circlecal.formats.registry import annotation_suffixes
    from circlecal.pictures.inputs import expand_inputs

    is_named = run.format_name is not None and run.keypoints is None
    return expand_inputs(inputs, annotation_suffixes() if is_named else ())


def leave_to_batch(named: Inputs, report: Callable[[Exception], None], with_options: str = "") -> None:
    """Report the videos and URLs among what is named: ``circlecal batch`` takes them, with these options.

    Raises
    ------
    InputError
        Nothing else is named.
    """
    from circlecal.errors import InputError

    for left, kind in ((named.videos, "a video"), (named.urls, "a URL")):
        if left:
            more = f" (and {len(left) - 1} more like it)" if len(left) > 1 else ""
            error = InputError(f"{left[0]}: is {kind}; circlecal batch{with_options} takes it{more}")
            if not named.paths:
                raise error
            report(error)


def _require_keypoints_of_each(frames: Sequence[PictureFile], run: FrameRun) -> None:
    """No file with the keypoints of one frame is given for several pictures.

    Raises
    ------
    InputError
        One is.
    """
    from collections import Counter

    from circlecal.errors import InputError
    from circlecal.files import is_folder
    from circlecal.formats.inputs import find_file_beside

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
    from circlecal.errors import InputError
    from circlecal.formats.registry import read_annotations

    try:
        _, found = read_annotations(path, run.size or ANY_SIZE, run.format_name)
    except InputError:  # told with each frame
        return False
    return len(found) == 1


def _frames_of(
    inputs: Sequence[Path], run: FrameRun, out: Path, report: Callable[[Exception], None]
) -> list[PictureFile | FrameOfFile]:
    from circlecal.errors import InputError
    from circlecal.files import exists
    from circlecal.formats.inputs import read_frames, refuse_overwriting, split_inputs
    from circlecal.pipeline import apply_convention, field_of

    if run.keypoints is not None and not exists(run.keypoints):
        raise InputError(f"{run.keypoints}: no such file or folder of keypoints")
    format_name = None if run.keypoints is not None else run.format_name
    pictures, files = split_inputs(inputs, format_name, exclude=[out])
    frames = choose_frames(pictures, out, run.mask) if pictures else []
    _require_keypoints_of_each(frames, run)
    note_unused_annotations(frames if run.keypoints is None else ())
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


def note_idle_options(
    frames: Sequence[PictureFile | FrameOfFile],
    size: str | None,
    convention: str | None,
    to: Sequence[str] | None,
    eval_size: str | None,
) -> None:
    """Say which of ``--size``, ``--convention`` and ``--eval-size`` was given and counts for nothing."""
    from circlecal.cli import console
    from circlecal.formats.inputs import FrameOfFile

    files = [frame for frame in frames if isinstance(frame, FrameOfFile)]
    if size is not None and frames and not files:
        console.print_note("--size counts for annotation files without a size, and only pictures are given")
    if convention is not None and all(file.observed.on_paint for file in files):
        console.print_note(
            "--convention counts for annotation files of other programs, and none is given that leaves it open; "
            "keypoints beside pictures and what circlecal wrote lie on the middle of the paint"
        )
    if eval_size is not None and not to:
        console.print_note("--eval-size counts for what --to writes, and no --to is given")


def note_unused_annotations(frames: Sequence[PictureFile]) -> None:
    """Say that annotations of other programs lie beside pictures and are not used.

    They are not taken unasked, as masks are: beside pictures lies what they are evaluated with.
    """
    from circlecal.cli import console
    from circlecal.formats.inputs import find_unused_annotations

    ignored = find_unused_annotations(frames)
    if ignored:
        more = f" and {len(ignored) - 1} more" if len(ignored) > 1 else ""
        console.print_note(
            f"{ignored[0]}{more}: an annotation beside its picture is not used; --keypoints FOLDER takes it together "
            "with the picture, and the file itself as an input takes it alone"
        )


def choose_frames_and_videos(
    inputs: Sequence[str], run: FrameRun, out: Path, report: Callable[[Exception], None]
) -> tuple[list[PictureFile | FrameOfFile], list[Video]]:
    """Pictures, frames of annotation files, and videos among the inputs.

    Raises
    ------
    InputError
        Nothing was found that can be read.
    """
    from circlecal.errors import InputError
    from circlecal.files import is_folder
    from circlecal.pictures.files import NoFramesError, PictureFile, distinct_names
    from circlecal.pictures.remote import url_names
    from circlecal.pictures.video import Video

    named = _expand_frames(inputs, run)
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
        frames = [] if alone else _frames_of(named.paths, run, out, report)
    except NoFramesError:
        if not videos:  # in a folder of videos lies what was written of them
            raise
        frames = []
    urls = _urls_of_pictures(named, report)
    ids = url_names(urls, [frame.id for frame in frames])
    frames += [PictureFile(name, Path(name), name, url=url) for name, url in zip(ids, urls, strict=True)]
    return frames, videos


def _urls_of_pictures(named: Inputs, report: Callable[[Exception], None]) -> list[str]:
    """The URLs among what is named, without those of videos, which are reported.

    Raises
    ------
    InputError
        Nothing but URLs of videos is named.
    """
    from circlecal.errors import InputError
    from circlecal.pictures.inputs import VIDEO_SUFFIXES

    videos = [url for url in named.urls if url.lower().endswith(VIDEO_SUFFIXES)]
    for url in videos:
        error = InputError(f"{url}: is the URL of a video; save the video, and give its file")
        if len(named.urls) == len(videos) and not named.paths and not named.videos:
            raise error
        report(error)
    return [url for url in named.urls if url not in videos]


def note_late_start(videos: Sequence[Video], sampling: Sampling) -> None:
    """Say of which videos nothing is taken, since they end before the time that was asked for."""
    from circlecal.cli import console

    for video in videos:
        if 0.0 < video.duration_s <= sampling.start_s:
            console.print_note(
                f"{video.path}: ends {video.duration_s:.1f} s after its first frame, as its header says, and "
                f"--start asks for {sampling.start_s:g} s"
            )


def _tell_way_to_video(paths: Sequence[Path]) -> str:
    """What to do with files that are no videos where one is needed."""
    from circlecal.files import is_folder
    from circlecal.pictures.files import PICTURE_SUFFIXES, walk

    animation = next((path for path in paths if path.suffix.lower() in (".gif", ".apng")), None)
    if animation is not None:
        return f"make one of the animation, as ffmpeg -i {animation.name} -pix_fmt yuv420p {animation.stem}.mp4 does"
    files = (file for path in paths for file in (walk(path) if is_folder(path) else [path]))
    picture = next((file for file in files if file.suffix.lower() in PICTURE_SUFFIXES), Path("frame.png"))
    pattern = picture.with_name(f"*{picture.suffix}")
    return (
        f"join the pictures of a clip to one, as ffmpeg -framerate 25 -pattern_type glob -i '{pattern}' "
        "-pix_fmt yuv420p clip.mp4 does; those of different views go to circlecal calibrate and batch"
    )


def choose_videos(inputs: Sequence[str], limits: LimitsConfig, report: Callable[[Exception], None]) -> list[Video]:
    """The videos among the inputs, with different names; those that cannot be read or are beyond the limits are
    reported.

    Raises
    ------
    InputError
        There is none, or something else is named.
    """
    from circlecal.errors import InputError
    from circlecal.files import require_input
    from circlecal.pictures.files import distinct_names
    from circlecal.pictures.inputs import expand_inputs
    from circlecal.pictures.video import Video

    named = expand_inputs(inputs)
    if named.urls:
        raise InputError(f"{named.urls[0]}: is a URL; save the video, and give its file")
    for path in named.paths:
        require_input(path)
    if not named.videos:
        raise InputError(f"{', '.join(inputs)}: holds no video; {_tell_way_to_video(named.paths)}")
    videos = []
    names = distinct_names([path.stem for path in named.videos])
    for path, name in zip(named.videos, names, strict=True):
        try:
            videos.append(Video.open(path, name, limits))
        except InputError as error:
            report(error)
    return videos
