"""Report pages, one self-contained HTML file a run, and summary images.

Importing the package imports none of its pages; `page.write_report` writes that of a calibration.
"""
