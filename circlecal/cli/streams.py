"""The standard streams of the program: whatever it was started with, they are there, and notes never end a run."""

from __future__ import annotations

import io
import os
import sys
from contextlib import suppress
from typing import Any

_LAST = 2
"""The descriptor of standard error, the last of the standard streams."""


def prepare_streams() -> None:
    """Open the standard streams that the process was started without, and drop notes that cannot be written."""
    _open_missing()
    if os.name == "posix" and sys.stderr is sys.__stderr__ and isinstance(sys.stderr, io.TextIOWrapper):
        notes = io.BufferedWriter(_Notes(sys.stderr.fileno(), "w", closefd=False))
        sys.stderr = io.TextIOWrapper(notes, encoding=sys.stderr.encoding, line_buffering=True)


def show_all_characters() -> None:
    """Let a terminal that lacks a character show its escape instead."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def drop_output() -> None:
    """Lead standard output to nowhere if it cannot be written: what it holds back would be tried once more when the
    process ends.
    """
    try:
        sys.stdout.flush()
    except OSError:
        with suppress(OSError):  # a stream of a test has no descriptor
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, sys.stdout.fileno())
            os.close(nowhere)


class _Notes(io.FileIO):
    """Standard error without its errors: where its disk is full, or its reader or its terminal is gone, what is written
    to it is lost, and the run goes on.
    """

    def write(self, text: Any, /) -> int:
        """Write some bytes, or none of them; the count says that they are done with."""
        try:
            written = super().write(text)
        except OSError:
            written = None
        return len(text) if written is None else written


def _open_missing() -> None:
    """Nothing is read from a stream that was closed by who started the process, and what is written to it is lost; no
    file of a run takes its descriptor, into which libraries write.
    """
    with suppress(OSError):
        while (descriptor := os.open(os.devnull, os.O_RDWR)) <= _LAST:
            os.set_inheritable(descriptor, True)
        os.close(descriptor)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115, PTH123 - for the whole process
