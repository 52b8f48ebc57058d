"""Files of which everything was refused, and what may help them: another sport, or no known camera."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from circlecal.config import Config
    from circlecal.overlay.canvas import Picture
    from circlecal.records.record import ResultRow

_FEW = 4
"""Refused files of which the ground is looked at, the first ones: that takes as long as to read them again."""


@dataclass(slots=True)
class RefusedFiles:
    """Pictures, and videos by a frame of theirs, in which nothing was calibrated: a video with one calibrated frame
    shows the sport that it was taken for.
    """

    _refused: dict[str, tuple[str, float | None]] = field(default_factory=dict)
    _calibrated: set[str] = field(default_factory=set)

    @classmethod
    def of_run(cls, folder: Path) -> Self:
        """Those of a finished run."""
        from circlecal.records.log import read_records
        from circlecal.records.record import ResultRow

        files = cls()
        for record in read_records(folder, ResultRow):
            files.add(record)
        return files

    def add(self, record: ResultRow) -> None:
        """Take note of a frame; annotations, and what could not be read, tell nothing."""
        from circlecal.pictures.files import PICTURE_SUFFIXES

        path = record.path or ""
        if record.status == "calibrated":
            self._calibrated.add(path)
            self._refused.pop(path, None)
            return
        time_s = None if record.source is None else record.source.time_s
        is_picture = time_s is not None or path.lower().endswith(PICTURE_SUFFIXES)
        if is_picture and path not in self._calibrated and record.code != "unreadable_input":
            self._refused.setdefault(path, (record.id, time_s))

    def print_hint(self, config: Config, *, is_chosen: bool, camera_prior: Path | None, venue: Path | None) -> None:
        """Say what may help them: to leave out the option that tells a known camera; else to try other sports, unless
        the user chose a field or any option (``is_chosen``).
        """
        from circlecal.cli import console

        known = "--camera-prior" if camera_prior else "--venue" if venue else None
        if self._refused and known is not None:
            console.print_note(f"leave {known} out for frames that another camera took: they are refused with it")
        elif self._refused and not is_chosen:
            console.print_note(self._name_sport(config))

    def _name_sport(self, config: Config) -> str:
        """Which of them lie on other ground than the field in use, or that they were taken for that field."""
        from circlecal.pipeline.field_choice import is_on_strange_ground

        strange = []
        for path, (name, time_s) in islice(self._refused.items(), _FEW):
            picture = _read_again(Path(path), time_s, config)
            if picture is not None and is_on_strange_ground(picture, config):
                strange.append(name)
        told = (
            f"{', '.join(strange)}: the ground is no turf"
            if strange
            else f"what was refused was taken for {config.field.template}"
        )
        return f"{told}; --field auto tries other sports"


def _read_again(path: Path, time_s: float | None, config: Config) -> Picture | None:
    """The picture of a frame; None where it cannot be had any more."""
    from circlecal.errors import InputError
    from circlecal.pictures.files import read_image
    from circlecal.pictures.video import pictures_at

    try:
        return read_image(path, config.limits) if time_s is None else next(pictures_at(path, [time_s]), None)
    except InputError:
        return None
