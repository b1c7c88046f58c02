"""The report page of a calibration: one HTML file that needs nothing else, and an image of it."""

from workbench.report.page import write_report

__all__ = ["write_report"]
