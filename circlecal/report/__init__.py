"""HTML report of a run: one folder of static pages to look through it with."""

from circlecal.report.pages import ReportOptions, write_report
from circlecal.report.reading import read_run

__all__ = ["ReportOptions", "read_run", "write_report"]
