"""The local web app of `workbench open`: what was measured and fitted, to look at, to edit and to run again.

`edits` holds what a person changes (plain Python, saved as session.toml); `data` reads runs and recordings and
decimates what is drawn; `figures` draws with plotly; `ui` is the page, made with trame; `server` serves it on
127.0.0.1 behind the checks of `security`; `jobs` runs `workbench` commands in the background.
"""
