"""Several calibrations at once for other programs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from circlecal.api.calibration import Calibration
from circlecal.errors import InputError
from circlecal.formats.exports import Exports, require_field
from circlecal.formats.registry import calibration_formats, require_format
from circlecal.names import as_stem


def export(
    frames: Iterable[Calibration], format: str, folder: str | Path, size: tuple[int, int] | None = None
) -> list[Path]:
    """Write calibrations for another program, all into one file where the format is one of a file for all frames.

    Parameters
    ----------
    frames : iterable of Calibration
        Such as a list of them, or a run that :func:`circlecal.load` opened; each with an id of its own.
    format, folder, size : str, path, (int, int), optional
        As for :meth:`Calibration.export`. A file for all frames that is there already is replaced.

    Returns
    -------
    list of path
        The files; refused frames are in none that holds cameras only.

    Raises
    ------
    InputError
        An unknown format or one that cannot say a field, two frames of one id, or a file that cannot be written.
    ConfigError
        As for :attr:`Calibration.field`.
    """
    require_format(format, calibration_formats(), "format", "format that can be written")
    exports = Exports([format], Path(folder), size)
    known: set[str] = set()
    for frame in frames:
        name = as_stem(frame.id).casefold()
        if name in known:
            raise InputError(f"{frame.id}: two frames have this id; give each its own: calibrate(image, id=...)")
        known.add(name)
        require_field([format], frame.field)
        frame.add_to(exports)
    exports.finish()
    return exports.written
