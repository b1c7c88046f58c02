"""The report page of a calibration: one HTML file that needs nothing else, and a picture of it."""

from workbench.report.page import write_report

__all__ = ["write_report"]
