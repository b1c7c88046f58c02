"""Buttons that go through a list one by one."""


def steps(name: str, last: str) -> tuple[str, str]:
    """Expressions of the browser that move a field back and on by one.

    The browser counts by itself, so that clicks in quick succession each count while the server is busy.
    """
    previous = f"{name} = Math.max(({name} || 0) - 1, 0)"
    return previous, f"{name} = Math.min(({name} || 0) + 1, {last})"
