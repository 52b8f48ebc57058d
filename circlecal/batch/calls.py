"""Many frames from Python."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from pathlib import Path

from circlecal.api import Run
from circlecal.api.calls import Settings, configure
from circlecal.batch.frames import FrameRun, label_masks
from circlecal.batch.inputs import choose_work, digest_annotations_of
from circlecal.batch.run import BatchProgress, run_batch
from circlecal.batch.workers import cpu_count
from circlecal.config import Config
from circlecal.formats.annotation import ANNOTATION_FOLDER
from circlecal.formats.unpacking import annotations_in
from circlecal.pipeline import field_of
from circlecal.records.log import RESULTS_NAME

_log = logging.getLogger(__name__)


def calibrate_batch(
    inputs: str | Path | Sequence[str | Path],
    out: str | Path = "circlecal-run",
    config: Config | str | Path | None = None,
    *,
    field: str | Path | None = None,
    set: Settings | None = None,
    mask: str | Path | None = None,
    keypoints: str | Path | None = None,
    annotations: str | Path | None = None,
    every: str | int | None = None,
    start: str | float | None = None,
    end: str | float | None = None,
    files: bool = False,
    workers: int | None = None,
    restart: bool = False,
    on_progress: Callable[[BatchProgress], None] = lambda progress: None,
) -> Run:
    """Calibrate many frames in worker processes into a folder, as ``circlecal batch`` does; called again, it goes on
    after a stop, and does nothing where all is done.

    What cannot be read is logged and left out. In a script the call stands below ``if __name__ == "__main__":``, since
    the workers import it.

    Parameters
    ----------
    inputs : path, or sequence of them
        Pictures, videos, annotation files, folders or ZIPs of them, patterns, numbered sequences (``x_%04d.png``),
        lists (``x.txt``).
    out : path
        Folder of ``results.jsonl`` and ``summary.csv``.
    config, field, set : optional
        As for :func:`circlecal.calibrate`.
    mask, keypoints, annotations : path, optional
        Folders of masks, of keypoints, and of what was named in the workbench; the last may be a ZIP, and is
        ``annotations`` in ``out`` where it is not given.
    every, start, end : optional
        What is taken of videos, as for :func:`circlecal.calibrate_video`.
    files : bool
        Whether each frame gets a result file and pictures of its own too.
    workers : int, optional
        Number of processes; one per processor when None.
    restart : bool
        Start over instead of going on.
    on_progress : callable
        Called with the counts at the start and after every frame.

    Returns
    -------
    Run
        The results of the folder, refused frames among them.

    Raises
    ------
    InputError
        Nothing to calibrate, or a folder that is not there, cannot be written to, or holds another run.
    ConfigError, MissingExtraError, TypeError
        As for :func:`circlecal.calibrate`.
    """
    chosen, folder = configure(config, field, set), Path(out)
    field_of(chosen)
    named = [inputs] if isinstance(inputs, str | os.PathLike) else list(inputs)
    named_in = annotations_in(None if annotations is None else Path(annotations), folder)
    run = FrameRun(
        chosen,
        out=folder if files else None,
        mask=None if mask is None else Path(mask),
        keypoints=None if keypoints is None else Path(keypoints),
        annotations=named_in or folder / ANNOTATION_FOLDER,
    )
    work = choose_work([str(name) for name in named], run, folder, (every, start, end), _log.warning, _log.warning)
    is_taken_up = not restart and (folder / RESULTS_NAME).is_file()
    run_batch(
        work.all_frames(_log.warning),
        run,
        folder,
        workers=workers or cpu_count(),
        total=work.total,
        restart=restart,
        annotations=digest_annotations_of(work, run.annotations, folder),
        masks=label_masks(work.frames) if is_taken_up and mask is None else None,
        on_progress=on_progress,
    )
    return Run(folder, own_field(chosen))


def own_field(config: Config) -> Path | None:
    """The file of the user's own template that a configuration names, without which results cannot be read back."""
    path = Path(config.field.template)
    return path if path.suffix in (".yaml", ".yml") else None
