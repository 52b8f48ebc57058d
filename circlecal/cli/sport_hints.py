"""What may help files of which everything was refused, and doubt of those that were calibrated on another ground than
that of their field: another sport, or no known camera.
"""

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
"""Files of which the ground is looked at, the first ones: that takes as long as to read them again."""


@dataclass(slots=True)
class SportHints:
    """Pictures, and videos by a frame of theirs: those in which nothing was calibrated, and the others."""

    _refused: dict[str, tuple[str, float | None]] = field(default_factory=dict)
    _calibrated: dict[str, tuple[str, float | None]] = field(default_factory=dict)

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
        time_s = None if record.source is None else record.source.time_s
        if not (time_s is not None or path.lower().endswith(PICTURE_SUFFIXES)) or record.code == "unreadable_input":
            return
        if record.status == "calibrated":
            self._calibrated.setdefault(path, (record.id, time_s))
            self._refused.pop(path, None)
        elif path not in self._calibrated:
            self._refused.setdefault(path, (record.id, time_s))

    def print_hint(self, config: Config, *, is_chosen: bool, camera_prior: Path | None, venue: Path | None) -> None:
        """Say what may help them: to leave out the option that tells a known camera; else to try other sports, unless
        the user chose a field or any option (``is_chosen``).
        """
        from circlecal.cli import console

        known = "--camera-prior" if camera_prior else "--venue" if venue else None
        if self._refused and known is not None:
            console.print_note(f"leave {known} out for frames that another camera took: they are refused with it")
        elif not is_chosen and known is None and (told := self._name_sport(config)) is not None:
            console.print_note(f"{told}; --field auto tries other sports")

    def _name_sport(self, config: Config) -> str | None:
        """Which files lie on other ground than the field in use, or that the refused ones were taken for that field."""
        strange = _find_strange(self._refused, config)
        if strange:
            return f"{', '.join(strange)}: the ground is no turf"
        if self._refused:
            return f"what was refused was taken for {config.field.template}"
        strange = _find_strange(self._calibrated, config)
        if strange:
            return f"{', '.join(strange)}: taken for {config.field.template}, but the ground is no turf"
        return None


def _find_strange(files: dict[str, tuple[str, float | None]], config: Config) -> list[str]:
    """Names of the files, among the first few, that lie on other ground than the field in use."""
    from circlecal.pipeline.field_choice import is_on_strange_ground

    strange = []
    for path, (name, time_s) in islice(files.items(), _FEW):
        picture = _read_again(Path(path), time_s, config)
        if picture is not None and is_on_strange_ground(picture, config):
            strange.append(name)
    return strange


def _read_again(path: Path, time_s: float | None, config: Config) -> Picture | None:
    """The picture of a frame; None where it cannot be had any more."""
    from circlecal.errors import InputError
    from circlecal.pictures.files import read_image
    from circlecal.pictures.video import pictures_at

    try:
        return read_image(path, config.limits) if time_s is None else next(pictures_at(path, [time_s]), None)
    except InputError:
        return None
