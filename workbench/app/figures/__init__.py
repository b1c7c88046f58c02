"""Figures of the app, drawn with plotly as those of the report pages are.

plotly draws in space as well as in the plane: a click on an arrow then gives its sample without a search of the
geometry, the page needs one library in the browser, and the server needs no graphics hardware.
"""
