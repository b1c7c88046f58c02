"""Attributes of widgets that trame does not know."""

from html import escape


def raw(**attributes: object) -> dict:
    """Attributes such as role and aria-label, as an argument of a widget.

    They stand in the page's template: they are words of this code, never of the data.
    """
    lines = []
    for name, value in attributes.items():
        dashed = name.replace("_", "-")
        lines.append(dashed if value is True else f'{dashed}="{escape(str(value))}"')
    return {"raw_attrs": lines}
