"""What the frames of a run that were calibrated alone tell those that were refused: which field the run shows, where
each frame was to tell that itself, and the colour of its paint.

Nothing is learnt while frames come in: after all of them were calibrated alone, what they agree on is told to the
refused ones, so neither the order of the frames nor the number of workers changes an answer. A frame that is calibrated
alone stays as it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from circlecal.batch.frames import FrameRun, calibrate_frame, picture_of_record, tell_mask, tell_size, write_outputs
from circlecal.config import AUTO, Config, find_template, suit_config
from circlecal.paint.colour import match_paint
from circlecal.paint.shared_paint import Colour, agree_on_paint, is_coloured
from circlecal.pictures.files import PictureFile
from circlecal.pictures.limits import LimitsConfig
from circlecal.pictures.remote import is_url
from circlecal.pipeline import field_of
from circlecal.records.json_text import write_result
from circlecal.records.parts import AloneRecord, LearntRecord
from circlecal.records.record import ResultRecord, ResultRow
from circlecal.records.writing import result_record
from circlecal.results import FrameCalibration
from circlecal.stages.mask import tell_paint


@dataclass(frozen=True, slots=True)
class Lesson:
    """What a run's calibrated frames agree on.

    Attributes
    ----------
    field : str
        Name of the field template.
    added_bgr : (float, float, float)
        What the paint adds to blue, green and red of the surface.
    frames : int
        How many frames agree.
    """

    field: str
    added_bgr: Colour
    frames: int

    @property
    def is_coloured(self) -> bool:
        """Whether the colour tells the paint better than its brightness does."""
        return is_coloured(self.added_bgr)


@dataclass(frozen=True, slots=True)
class RefusedFrame:
    """A frame that is calibrated again, by its record, and what it is told."""

    id: str
    record: ResultRecord
    lesson: Lesson

    @property
    def time_s(self) -> float | None:
        """Time in its video."""
        return None if self.record.source is None else self.record.source.time_s


def learn(rows: Iterable[ResultRow], config: Config) -> dict[str, Lesson]:
    """What the frames of each folder and each video agree on, by its name; nothing where too few frames agree.

    Parameters
    ----------
    rows : iterable of ResultRow
        All frames of a run.
    config : Config
        Its configuration, of which the section ``learning`` is used.
    """
    seen: dict[str, list[tuple[str, Colour]]] = {}
    for row in rows:
        is_alone = row.learnt is None or not row.learnt.taken
        if row.status == "calibrated" and is_alone and row.paint is not None and row.field is not None:
            blue, green, red = (float(value or 0.0) for value in row.paint.added_bgr)
            seen.setdefault(_group_of(row), []).append((row.field.template, (blue, green, red)))
    found = {}
    for group, told in sorted(seen.items()):
        lesson = _agree(told, config.learning.least_frames)
        is_new = (
            config.field.template == AUTO
            and lesson is not None
            and find_template(config, lesson.field) != config.field.among[0]
        )
        if lesson is not None and (lesson.is_coloured or is_new):
            found[group] = lesson
    return found


def _agree(told: list[tuple[str, Colour]], least: int) -> Lesson | None:
    """The field and the paint of frames that agree on both; None where they do not."""
    fields = {name for name, _ in told}
    agreed = agree_on_paint([colour for _, colour in told], least)
    return None if len(fields) != 1 or agreed is None else Lesson(fields.pop(), *agreed)


def _group_of(row: ResultRow) -> str:
    """What a frame shares its field with: the video, or the other pictures of its folder."""
    path, time_s = row.path or "", None if row.source is None else row.source.time_s
    if is_url(path):
        return path.rpartition("/")[0]
    file = Path(path).absolute()  # one run may name its files from the working folder, and whole after a stop
    return str(file if time_s is not None else file.parent)


@dataclass(frozen=True)
class LearnedRun:
    """Calibrating the refused frames of a run again with what the others agree on, in any process.

    Attributes
    ----------
    run : FrameRun
        How the frames were calibrated alone.
    lessons : mapping
        As :func:`learn` gives them.
    """

    run: FrameRun
    lessons: Mapping[str, Lesson]

    @property
    def seed(self) -> int:
        """Seed of the random draws."""
        return self.run.seed

    @property
    def limits(self) -> LimitsConfig:
        """What a frame may take."""
        return self.run.limits

    @cached_property
    def digest(self) -> str:
        """That of the run: what is learnt follows from its frames."""
        return self.run.digest

    def source(self, frame: RefusedFrame) -> str:
        """File of a frame."""
        return str(frame.record.path)

    def choose(self, records: Iterable[ResultRecord]) -> Iterator[RefusedFrame]:
        """The frames that something is to be told to, and that were not told the same before."""
        for record in records:
            lesson = self.lesson_of(record)
            if lesson is not None:
                yield RefusedFrame(record.id, record, lesson)

    def lesson_of(self, record: ResultRow) -> Lesson | None:
        """What is to be told to a frame; None where it was told that before, or nothing helps it."""
        lesson, told = self.lessons.get(_group_of(record)), record.learnt
        alone = record.status if told is None else told.alone.status
        is_open = alone == "refused" and record.stage != "input" and record.annotation is None
        is_new = lesson is not None and (told is None or _differ(told, lesson))
        return lesson if is_open and is_new else None

    def record(self, frame: RefusedFrame) -> ResultRecord:
        """The frame's record with what it was told; that of the frame alone where it does not help.

        Raises
        ------
        InputError
            The picture cannot be read any more, or a file cannot be written.
        """
        lesson, told = frame.lesson, frame.record.learnt
        file = picture_of_record(frame.record)
        config = self._tell(lesson)
        again, is_in_one_paint = self._calibrate(file, config), field_of(config)[0].is_in_one_paint
        taken = again.record.status == "calibrated" and _shows(again.record, lesson, is_in_one_paint)
        answer: _Answer | None = again if taken else None
        if not taken and told is not None and told.taken:  # told something else, which no longer holds
            answer = self._calibrate(file, self.run.config)
        before = frame.record if told is None else told.alone
        learnt = LearntRecord(
            field=lesson.field,
            added_bgr=lesson.added_bgr,
            frames=lesson.frames,
            taken=taken,
            alone=AloneRecord(status=before.status, code=before.code, reason=before.reason),
        )
        record = tell_size(frame.record if answer is None else tell_mask(answer.record, file), file)
        record = record.model_copy(update={"learnt": learnt, "config_digest": self.digest})
        out = self.run.out
        if out is not None and answer is None:
            write_result(out / f"{frame.id}.json", record)
        elif out is not None and answer is not None:
            write_outputs(answer.picture, answer.found, record, answer.config, out)
        return record

    def _tell(self, lesson: Lesson) -> Config:
        """The configuration of a frame that is told the field and the colour of its paint."""
        config = self.run.config
        chosen = suit_config(config, lesson.field) if config.field.template == AUTO else config
        if not lesson.is_coloured:
            return chosen
        return chosen.model_copy(update={"mask": tell_paint(chosen.mask, lesson.added_bgr)})

    def _calibrate(self, file: PictureFile, config: Config) -> _Answer:
        picture, found = calibrate_frame(file, config, None)
        template = found.template or field_of(config)[0]
        record = result_record(found, template, time_s=file.time_s, digest=self.digest)
        return _Answer(picture, found, record, config)


@dataclass(frozen=True, slots=True)
class _Answer:
    """A frame that was calibrated again: its picture, the calibration, its record, and under which configuration."""

    picture: NDArray[np.uint8]
    found: FrameCalibration
    record: ResultRecord
    config: Config


def learn_from(run: object, rows: Iterable[ResultRow]) -> LearnedRun | None:
    """How the refused frames of a run are calibrated again; None where nothing is learnt.

    Parameters
    ----------
    run : object
        How they were calibrated alone; of anything but a :class:`circlecal.batch.frames.FrameRun` nothing is learnt.
    rows : iterable of ResultRow
        All frames of the run.
    """
    if not isinstance(run, FrameRun):
        return None
    config = run.config
    is_told = run.mask is not None or run.keypoints is not None or config.mask.paint_bgr is not None
    if is_told or not config.learning.enabled:
        return None
    lessons = learn(rows, config)
    return LearnedRun(run, lessons) if lessons else None


def _differ(told: LearntRecord, lesson: Lesson) -> bool:
    return (told.field, told.added_bgr, told.frames) != (lesson.field, lesson.added_bgr, lesson.frames)


def _shows(record: ResultRecord, lesson: Lesson, is_in_one_paint: bool) -> bool:
    """Whether an answer has the paint of the run, whose field may have all of its lines in one."""
    if record.paint is None:
        return not is_in_one_paint
    return bool(match_paint(np.array(record.paint.added_bgr, np.float64), np.array(lesson.added_bgr)))
