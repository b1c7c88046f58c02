"""Report page of a calibration: one self-contained HTML file and a summary image."""

from workbench.report.page import write_report

__all__ = ["write_report"]
