"""The distribution of an audit's distances as a picture; needs the extra ``plot``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from circlecal.errors import InputError, MissingExtraError
from circlecal.geometry.projective import Array

SUFFIXES = (".png", ".svg")


def check_plot(path: Path) -> None:
    """Fail before any work where the plot could not be written.

    Raises
    ------
    InputError
        Another suffix than png or svg.
    MissingExtraError
        matplotlib is not installed.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: a plot is written as {' or '.join(SUFFIXES)}")
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("matplotlib", "plot") from error


def plot_distances(by_pair: Mapping[tuple[int, int], Array], path: Path, title: str) -> None:
    """Cumulative distribution of the distances of every opposed pair.

    Raises
    ------
    InputError, MissingExtraError
        As :func:`check_plot`, or the file cannot be written.
    """
    check_plot(path)
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    axes = figure.add_subplot()
    for (first, second), values in by_pair.items():
        ordered = np.sort(values)
        share = np.arange(1, len(ordered) + 1) / len(ordered)
        label = f"{first}-{second} (median {np.median(ordered):.1f} px, {len(ordered)} frames)"
        axes.step(np.concatenate([[0.0], ordered]), np.concatenate([[0.0], share]), where="post", label=label)
    largest = max((float(np.percentile(v, 98)) for v in by_pair.values()), default=1.0)
    axes.set(xlim=(0.0, max(largest, 1.0)), ylim=(0.0, 1.0), xlabel="distance from centre to line, px")
    axes.set(ylabel="share of frames", title=title)
    if by_pair:
        axes.legend(title="keypoints", fontsize="small", loc="lower right")
    axes.grid(alpha=0.3)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=150)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
