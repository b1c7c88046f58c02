"""Keyboard shortcuts of the page: Ctrl+Z takes the last change back, Ctrl+Y or Ctrl+Shift+Z makes it again.

In a text field the keys keep what they do in every text field.
"""

from collections.abc import Callable

_SCRIPT = """
document.addEventListener('keydown', (event) => {
    const key = event.key.toLowerCase();
    const isText = event.target.closest('input:not([type=checkbox]):not([type=range]), textarea');
    if (!(event.ctrlKey || event.metaKey) || isText || !['z', 'y'].includes(key)) return;
    event.preventDefault();
    window.trame.trigger(key === 'z' && !event.shiftKey ? '%s' : '%s');
});
"""


def undo_keys(server, undo: Callable, redo: Callable) -> str:
    """Script of the page that calls two handlers of the server by their keys; a command key does as a control key."""
    return _SCRIPT % (server.trigger_name(undo), server.trigger_name(redo))


__all__ = ["undo_keys"]
