"""Blind benchmark of the diagnosis: suites of cases, fixed scoring rules, figures of the scoreboard."""
