"""Many frames: worker processes or a cluster, append-only results, resume; one bad frame never stops the rest.

``results.jsonl`` has one line per finished frame, written before the next one is counted, so killing a run loses at
most the frames in flight; a line torn by a kill or a full disk is cut off when the run is resumed. ``results.index`` is
what a resumed run reads instead of all these lines; it is made anew where it is missing or does not fit.
``summary.csv`` is written from it when the run ends.
"""

from circlecal.batch.run import SUMMARY_NAME, BatchProgress, run_batch
from circlecal.batch.task import Task

__all__ = [
    "SUMMARY_NAME",
    "BatchProgress",
    "Task",
    "run_batch",
]
