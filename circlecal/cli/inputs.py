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
    from circlecal.batch.inputs import choose_frames_of, expand_frames
    from circlecal.cli import console

    named = expand_frames(inputs, run, out, console.print_note)
    leave_to_batch(named, report)
    return choose_frames_of(named.paths, run, out, report, console.print_note)


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


def note_run_beside_files(out: Path, *, is_run: bool) -> None:
    """Say that result files and a run are about to lie in one folder, of which all other commands read the run alone.

    Parameters
    ----------
    out : path
        The folder.
    is_run : bool
        Whether a run goes there; result files otherwise.
    """
    from circlecal.cli import console
    from circlecal.records.log import RESULTS_NAME, holds_result_files

    log = out / RESULTS_NAME
    if not is_run and log.is_file():
        told = f"holds a run; other commands read its {RESULTS_NAME} alone, and not what is written beside it"
    elif is_run and not log.is_file() and holds_result_files(out):
        told = f"holds results of circlecal calibrate; with a {RESULTS_NAME} beside them other commands read that alone"
    else:
        return
    console.print_note(f"{out}: {told}; another --out keeps them apart")


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
