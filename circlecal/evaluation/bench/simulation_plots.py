"""Plots of ``circlecal simulate``: error against noise with quantile bands, failures, and the Cramer-Rao bound."""

from __future__ import annotations

import importlib.util
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from circlecal.errors import MissingExtraError
from circlecal.evaluation.bench.simulation import Summary
from circlecal.files import write_atomic

FORMATS = ("png", "svg")
LEAST_PX = 0.01
"""Smaller errors are drawn as this, on the logarithmic axis of a plot they would push all others together."""
COLORS = (
    "#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f", "#bcbd22", "#17becf",
    "#1b3a6b", "#7a0045", "#a6761d", "#00664a",
)  # fmt: skip
"""One colour for each solver, the first ten those of matplotlib; no two solvers that are registered share one."""
_MARKERS = "osv^D<>pPX*hd8"


def require_matplotlib() -> None:
    """Raise before a long run rather than after it.

    Raises
    ------
    MissingExtraError
        Where matplotlib is not installed.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise MissingExtraError("matplotlib", "plot")


def write_plots(summaries: Sequence[Summary], folder: Path) -> list[Path]:
    """One figure per scenario as PNG and SVG: errors above, share of failures below."""
    require_matplotlib()
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    written = []
    for scenario in dict.fromkeys(s.scenario for s in summaries):
        own = [s for s in summaries if s.scenario == scenario]
        figure = Figure(figsize=(9.0, 8.0), layout="constrained")
        FigureCanvasAgg(figure)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        for k, solver in enumerate(dict.fromkeys(s.solver for s in own)):
            _draw_solver(above, below, [s for s in own if s.solver == solver], k)
        _draw_bound(above, own)
        _label(figure, above, below, scenario, sorted({s.noise_px for s in own}))
        with matplotlib.rc_context({"svg.hashsalt": "circlecal"}):
            written += [_save(figure, folder / f"simulate_{scenario}.{kind}", kind) for kind in FORMATS]
    return written


def _draw_solver(above: Any, below: Any, own: list[Summary], k: int) -> None:
    own = sorted(own, key=lambda s: s.noise_px)
    noise = [s.noise_px for s in own]
    marker, color = _MARKERS[k % len(_MARKERS)], COLORS[k % len(COLORS)]
    below.plot(noise, [100.0 * s.failed for s in own], marker=marker, color=color)
    answered = [
        (s.noise_px, max(s.q10_px, LEAST_PX), max(s.median_px, LEAST_PX), max(s.p90_px, LEAST_PX))
        for s in own
        if s.q10_px is not None and s.median_px is not None and s.p90_px is not None
    ]
    if not answered:  # named all the same, since its failures are drawn
        above.plot([], [], marker=marker, color=color, label=f"{own[0].solver} (no answer)")
        return
    x, low, middle, high = zip(*answered, strict=True)
    above.plot(x, middle, marker=marker, color=color, label=own[0].solver)
    above.fill_between(x, low, high, color=color, alpha=0.12, linewidth=0)


def _draw_bound(above: Any, own: list[Summary]) -> None:
    bounds = sorted({(s.noise_px, s.bound_median_px) for s in own if s.bound_median_px > 0})
    if bounds:
        above.plot(*zip(*bounds, strict=True), "k--", linewidth=2, label="Cramer-Rao bound (pinhole camera)")


def _label(figure: Any, above: Any, below: Any, scenario: str, noises_px: list[float]) -> None:
    above.set_yscale("log")
    below.set_xscale("symlog", linthresh=1.0)
    below.set_xticks(noises_px, [f"{noise:g}" for noise in noises_px])
    below.set_xlim(noises_px[0] - 0.1, 1.15 * noises_px[-1] + 0.1)
    below.minorticks_off()
    above.set_ylabel("mean reprojection error, px (median, 10-90 %)")
    above.grid(alpha=0.3)
    if above.get_legend_handles_labels()[0]:
        above.legend(fontsize="small", ncols=2)
    below.set_ylabel("no answer, %")
    below.set_ylim(-3, 103)
    below.set_xlabel("noise, px")
    below.grid(alpha=0.3)
    figure.suptitle(scenario)


def _save(figure: Any, path: Path, kind: str) -> Path:
    content = io.BytesIO()
    metadata = {"Date": None} if kind == "svg" else {"Software": None}
    figure.savefig(content, format=kind, dpi=110, metadata=metadata)
    write_atomic(path, content.getvalue())
    return path
