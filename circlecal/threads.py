"""Threads of linear algebra: the systems here are small, and threads that wait for each other only cost time."""

from __future__ import annotations

__all__ = ["ONE_THREAD"]

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment variables that libraries of linear algebra read when they are loaded."""
