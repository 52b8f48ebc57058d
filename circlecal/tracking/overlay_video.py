"""``overlay.mp4``: a clip with the field template drawn through the camera of every frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import tee
from pathlib import Path

from circlecal.field import Circle, FieldTemplate
from circlecal.overlay.clip_overlay import draw_clip_frame
from circlecal.pictures.video import Video, pictures_at
from circlecal.pictures.video_writer import write_video
from circlecal.records.record import ResultRecord

OVERLAY_NAME = "overlay.mp4"
OPEN_SIGMA_PX = 32.0
"""Standard deviation, pixels at 1920 px width, from which on a marking is dashed."""


def write_overlay_video(
    path: Path,
    video: Video,
    records: Iterable[ResultRecord],
    template: FieldTemplate,
    circle: Circle,
    step_s: float,
    on_frame: Callable[[str], None] = lambda name: None,
) -> None:
    """Write the overlay of a clip, one frame in memory at a time.

    Parameters
    ----------
    path : path
        The video, H.264 in MP4; each frame has the time that it has in the clip.
    video : Video
        The clip.
    records : iterable of ResultRecord
        Of its frames, in the order of time; frames without a record are left out.
    template, circle : FieldTemplate, Circle
        The field, and the circle in its own colour.
    step_s : float
        Time between two of the frames, seconds: how long the last one is shown.
    on_frame : callable
        Called with the id after each frame.

    Raises
    ------
    InputError
        The clip cannot be read any more, or the video cannot be written.
    """
    wanted, asked = tee(record for record in records if _time(record) is not None)
    pictures = pictures_at(video.path, _times(asked))
    with write_video(path, 1.0 / step_s, video.aspect) as writer:
        for record, picture in zip(wanted, pictures, strict=False):
            time_s = _time(record)
            if picture is not None and time_s is not None:
                facts = frame_facts(record)
                drawn = draw_clip_frame(picture, record.view, template, circle.name, time_s, facts, OPEN_SIGMA_PX)
                writer.write(drawn, time_s)
            on_frame(record.id)


def frame_facts(record: ResultRecord) -> list[str]:
    """What a strip tells of a frame, in a few words each."""
    camera, track = record.camera, record.track
    facts = [] if track is None else [f"shot {track.shot}"]
    if camera is None:
        return [*facts, f"refused: {record.reason or record.code}"]
    if record.rig is not None and record.rig.camera is not None:
        facts.append(record.rig.camera)
    facts += [f"pan {camera.pan_degrees:z.1f}", f"tilt {camera.tilt_degrees:z.1f}", f"f {camera.x_focal_length:.0f} px"]
    if camera.max_sigma_px is not None:
        facts.append(f"sigma {camera.max_sigma_px:.2f} px")
    return [*facts, *([] if track is None else ["+".join(track.carried_by)])]


def _time(record: ResultRecord) -> float | None:
    return None if record.source is None else record.source.time_s


def _times(records: Iterable[ResultRecord]) -> Iterator[float]:
    return (time_s for record in records if (time_s := _time(record)) is not None)
